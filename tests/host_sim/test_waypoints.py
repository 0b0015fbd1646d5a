"""Files of waypoints: what is read, and that every mistake is told with its line and its cure."""

from pathlib import Path

import numpy as np
import pytest

from host_sim.errors import OmnibotError
from host_sim.limits import NO_LIMITS, Limits
from host_sim.planner import PathRequest, default_speed, plan
from host_sim.waypoints import read_waypoints

TOML = """
[limits]
speed_m_per_s = 0.8
jerk_m_per_s3 = 20
[[waypoint]]
x1_m = 0
x2_m = 1.5
[[waypoint]]
x2_m = -2.0
x1_m = 1
heading_rad = 0.5
"""


def write(folder: Path, text: str, name: str = "path.csv") -> str:
    file = folder / name
    file.write_text(text, "utf-8")
    return str(file)


def test_csv_columns_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    read = read_waypoints(write(tmp_path, "heading_rad, x2_m,x1_m\n0.1,2,1\n\n# a note\n-7e-1, -4 ,3\n"))
    np.testing.assert_array_equal(read.places, [[1.0, 2.0, 0.1], [3.0, -4.0, -0.7]])
    assert read.time_s is None
    assert read.limits == NO_LIMITS


def test_csv_of_a_spreadsheet_with_byte_order_mark_and_carriage_returns_is_read(tmp_path: Path) -> None:
    file = tmp_path / "PATH.CSV"
    file.write_bytes(b'\xef\xbb\xbf"x1_m",x2_m\r\n0,0\r\n"1.5",2\r\n')
    np.testing.assert_array_equal(read_waypoints(str(file)).places, [[0.0, 0.0, 0.0], [1.5, 2.0, 0.0]])


def test_csv_with_times_has_them(tmp_path: Path) -> None:
    read = read_waypoints(write(tmp_path, "time_s,x1_m,x2_m\n0,0,0\n2.5,0,0\n"))
    assert read.time_s is not None
    np.testing.assert_array_equal(read.time_s, [0.0, 2.5])


def test_toml_has_waypoints_and_limits(tmp_path: Path) -> None:
    file = write(tmp_path, TOML, "path.toml")
    read = read_waypoints(file)
    np.testing.assert_array_equal(read.places, [[0.0, 1.5, 0.0], [1.0, -2.0, 0.5]])
    assert read.limits == Limits(speed_m_per_s=0.8, jerk_m_per_s3=20.0)
    assert default_speed(file) == 0.8
    assert default_speed(write(tmp_path, "x1_m,x2_m\n0,0\n1,1\n")) == default_speed("circle") == 0.5


HEAD = "x1_m,x2_m\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty; it must have a header line and waypoints"),
        ("# only this\n", "is empty"),
        (
            "0,0\n1,1\n",
            "line 1: no column '0' is known; there are: x1_m, x2_m, heading_rad, time_s, separated by commas",
        ),
        ("\nx1_m;x2_m\n0;0\n", "line 2: no column 'x1_m;x2_m' is known"),
        ("x1_m,y\n", "line 1: no column 'y' is known"),
        ("x1_m,x1_m,x2_m\n", "line 1: column x1_m is there twice"),
        ("x1_m,heading_rad\n", "line 1: column x2_m is missing; there must be x1_m and x2_m"),
        (HEAD + "0,0\n", "has 1 waypoints; there must be 2 to 1000"),
        (HEAD + 1001 * "0,0\n", "has 1001 waypoints"),
        (HEAD + "0,0\n\n1,2,3\n", "line 4 has 3 cells; it must have 2: x1_m, x2_m"),
        (HEAD + "0,0\n1,\n", "line 3: x2_m =  must be a number from -20 to 20"),
        (HEAD + "0,0\n1,two\n", "line 3: x2_m = two must be a number from -20 to 20"),
        (HEAD + "0,0\n1,nan\n", "line 3: x2_m = nan must be a number from -20 to 20"),
        (HEAD + "0,0\n20.5,0\n", "line 3: x1_m = 20.5 must be a number from -20 to 20"),
        (HEAD + "0,0\n1,1\n1,1\n", "line 4 is the waypoint before it again; leave one of the two out"),
        ("x1_m,x2_m,time_s\n0,0,1\n1,1,2\n", "line 2: time_s = 1 must be 0 at the first waypoint"),
        ("x1_m,x2_m,time_s\n0,0,0\n1,1,2\n1,2,2\n", "line 4: time_s = 2 must be later than 2, by 0.001 s at least"),
        ("x1_m,x2_m,time_s\n0,0,0\n1,1,4000\n", "line 3: time_s = 4000 must be a number from -3600 to 3600"),
    ],
)
def test_csv_mistake_is_told_with_its_line_and_cure(tmp_path: Path, text: str, says: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(OmnibotError) as error:
        read_waypoints(file)
    assert str(error.value).startswith(file)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[limits\n", "at line 1"),
        ("speed = 1\n", "speed is not known; there are: [limits], [[waypoint]]"),
        ("[waypoint]\nx1_m = 0\n", "waypoints must be tables [[waypoint]]"),
        ("limits = 3\n", "limits must be a table [limits]"),
        (TOML + "y = 1\n", "waypoint 2: no entry 'y' is known"),
        (TOML + "time_s = 1\n", "all waypoints must have a time_s, or none"),
        (TOML.replace("x2_m = -2.0", ""), "waypoint 2: entry x2_m is missing"),
        (TOML.replace("-2.0", "true"), "waypoint 2: x2_m = True must be a number from -20 to 20"),
        (
            TOML.replace("jerk_m_per_s3", "jerk"),
            "[limits]: jerk is not known; there are: accel_m_per_s2, jerk_m_per_s3, ",
        ),
        (TOML.replace("20", "0"), "[limits]: limit jerk_m_per_s3 = 0 must be a number from 1e-06"),
        (TOML.replace("20", "'fast'"), "[limits]: jerk_m_per_s3 = fast must be a number"),
        ("", "has 0 waypoints"),
    ],
)
def test_toml_mistake_is_told_with_its_place_and_cure(tmp_path: Path, text: str, says: str) -> None:
    file = write(tmp_path, text, "path.toml")
    with pytest.raises(OmnibotError) as error:
        read_waypoints(file)
    assert str(error.value).startswith(file)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_file_that_is_not_there_or_no_text_is_told(tmp_path: Path) -> None:
    with pytest.raises(OmnibotError, match=r"cannot read .*none.csv: No such file"):
        plan(PathRequest(str(tmp_path / "none.csv"), 0.5))
    (tmp_path / "zip.csv").write_bytes(b"PK\xff\xfe")
    with pytest.raises(OmnibotError, match=r"is no text in UTF-8: .* at byte 2"):
        plan(PathRequest(str(tmp_path / "zip.csv"), 0.5))
