"""The parameters of a robot, as the robot itself tells them over the bus."""

import contextlib
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from host_sim.errors import OmnibotError
from host_sim.link import Link, RefusedError, SilentError
from host_sim.robot import Parameter, Robot, parameter_named, shortest

# A robot that drives answers every tick, by default each millisecond.
LISTEN_S = 0.25
# A save may take a board two seconds, in which it says nothing.
SAVE_S = 5.0
MOVING = ("ARMED", "TRACKING", "STOPPING")
TEXT_PARTS = 16  # that PARAMETER_GET can ask for

NO_MEMORY = ": this robot has no memory for them; start it as omnibot-sil --parameters FILE, which stands for one"
ORIGINS = {
    "DEFAULTS": "the defaults, for nothing was kept",
    "KEPT": "what was kept",
    "LOST": "the defaults, for what was kept is lost",
    "NO_MEMORY": "the defaults, for it has no memory to keep others",
}


class Held(NamedTuple):
    """A parameter and the value in force."""

    parameter: Parameter
    value: float

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        told = self.parameter
        return {
            "index": told.index,
            "name": told.name,
            "value": plain(told, self.value),
            "default": plain(told, told.default),
            "minimum": told.minimum,
            "maximum": told.maximum,
            "unit": told.unit,
            "type": "integer" if told.integer else "real",
            "choices": list(told.choices),
        }


class Store(NamedTuple):
    """Where the parameters come from, and how many of them differ from what is kept."""

    origin: str
    unsaved: int


class Change(NamedTuple):
    """A parameter that had one value and has another now."""

    parameter: Parameter
    before: float
    after: float


def _change(held: Held, text: str) -> Change:
    """Return what a text asks for; the range is the robot's business, single precision is the wire's."""
    with np.errstate(over="ignore"):
        return Change(held.parameter, held.value, float(np.float32(held.parameter.number(text))))


def plain(parameter: Parameter, value: float) -> float | str:
    """Return a value for a file: the name of a choice, or the shortest number of single precision."""
    text = parameter.text(value)
    return text if parameter.choices else int(text) if parameter.integer else float(text)


# ---- what the robot tells


class _UnknownIndexError(OmnibotError):
    """The robot has no parameter of that index."""


def _answer(link: Link, wanted: tuple[int, int, int], wait_s: float) -> dict[str, float] | None:
    """Return the answer to a question for a field; those to other questions, of whomever, are passed over."""
    deadline = time.monotonic() + wait_s
    while (left_s := deadline - time.monotonic()) > 0.0:
        name, values = link.hear(left_s) or ("", {})
        if name not in ("PARAMETER_VALUE", "PARAMETER_TEXT"):
            continue
        if (values["index"], values["field"], values.get("part", wanted[2])) == wanted:
            return values
    return None


def _ask(link: Link, index: int, field: str, part: int = 0) -> dict[str, float]:
    """Ask for a part of a field until it is told."""
    number = link.codec["PARAMETER_GET"].choices["field"][field]
    for _ in range(max(1, round(link.timeout_s / link.repeat_s))):
        link.send("PARAMETER_GET", index, number, part)
        answer = _answer(link, (index, number, part), link.repeat_s)
        if answer is None:
            continue
        result = link.codec["PARAMETER_VALUE"].label("result", answer.get("result", 0))
        if result == "UNKNOWN_INDEX":
            raise _UnknownIndexError(f"the firmware has no parameter {index}")
        if result != "OK":
            raise RefusedError(f"the firmware refused {field} of parameter {index}: {result}")
        return answer
    raise SilentError(
        f"no answer about parameter {index} from node {link.codec.node} on {link.bus.channel_info} "
        f"within {link.timeout_s:g} s"
    )


def _text(link: Link, index: int, field: str) -> str:
    """Return a field that is a text."""
    text = ""
    for part in range(TEXT_PARTS):
        answer = _ask(link, index, field, part)
        piece = bytes(int(answer[f"char{i}"]) for i in range(6))
        text += piece.split(b"\0")[0].decode("ascii", errors="replace")
        if b"\0" in piece:
            break
    return text


def read_value(link: Link, index: int) -> float:
    """Return the value in force of a parameter."""
    return _ask(link, index, "VALUE")["value"]


def _describe(link: Link, index: int, robot: Robot) -> Parameter:
    """Ask for all fields of a parameter. The names of choices are not on the wire: they are the robot file's."""
    number = {field: _ask(link, index, field)["value"] for field in ("DEFAULT", "MINIMUM", "MAXIMUM", "TYPE")}
    name = _text(link, index, "NAME")
    known = next((p for p in robot.parameters if (p.index, p.name) == (index, name)), None)
    return Parameter(
        index=index,
        name=name,
        symbol=known.symbol if known else "",
        integer=number["TYPE"] == 1.0,
        unit=_text(link, index, "UNIT"),
        minimum=shortest(number["MINIMUM"]),
        maximum=shortest(number["MAXIMUM"]),
        default=shortest(number["DEFAULT"]),
        source=known.source if known else "",
        choices=known.choices if known else (),
    )


def read_all(link: Link, robot: Robot) -> list[Held]:
    """Return every parameter that the robot has, in its order."""
    held = []
    with contextlib.suppress(_UnknownIndexError):
        for index in range(256):
            value = read_value(link, index)
            held.append(Held(_describe(link, index, robot), value))
    return held


# ---- a session


def mode_heard(link: Link) -> str | None:
    """Listen for a while and return the mode that the robot tells unasked; one that nobody drives may be silent."""
    deadline = time.monotonic() + LISTEN_S
    while (left_s := deadline - time.monotonic()) > 0.0:
        name, values = link.hear(left_s) or ("", {})
        if name in ("TORQUE", "STATUS"):
            return link.codec[name].label("mode", values["mode"])
    return None


class Session:
    """Reads and changes the parameters of one robot; one that drives for another host is not disturbed.

    Parameters
    ----------
    link
        To the robot; nothing was sent yet.
    robot
        Where the names of choices come from.
    """

    def __init__(self, link: Link, robot: Robot) -> None:
        self._link = link
        mode = mode_heard(link)
        # HELLO would end a drive, and a request without one is not taken.
        self.moving = mode if mode in MOVING else None
        self.store = None if self.moving else self._greet()
        self.held = read_all(link, robot)

    def _greet(self) -> Store:
        self._link.greet()
        return self._told_store()

    def _told_store(self) -> Store:
        values = self._link.wait_for("PARAMETER_STORE")
        return Store(self._link.codec["PARAMETER_STORE"].label("origin", values["origin"]), int(values["unsaved"]))

    def named(self, name: str) -> Held:
        """Return the parameter of a name, or say which names are near it."""
        return self.held[[held.parameter for held in self.held].index(self._parameter(name))]

    def _parameter(self, name: str) -> Parameter:
        return parameter_named(name, [held.parameter for held in self.held])

    def differences(self, values: Mapping[str, str] | None) -> list[Change]:
        """Return where the values in force are not those given, or the defaults: given before, in force after."""
        if values is None:
            wanted = [Change(p, p.default, value) for p, value in self.held]
        else:
            asked = [_change(self.named(name), text) for name, text in values.items()]
            wanted = [Change(change.parameter, change.after, change.before) for change in asked]
        return [change for change in wanted if shortest(change.before) != shortest(change.after)]

    def change(self, values: Mapping[str, str]) -> list[Change]:
        """Set parameters, all or none: what the robot refuses takes back those that were set before it."""
        self._refuse_in_motion()
        changes = [_change(self.named(name), text) for name, text in values.items()]
        for done, change in enumerate(changes):
            try:
                self._link.request_parameter(change.parameter, change.after)
            except OmnibotError:
                for earlier in reversed(changes[:done]):
                    self._link.request_parameter(earlier.parameter, earlier.before)
                raise
        self._refresh(changes)
        return changes

    def reset(self, names: list[str]) -> list[Change]:
        """Put the defaults in force, of all parameters where no names are given."""
        self._refuse_in_motion()
        told = [self.named(name) for name in names] or self.held
        changes = [Change(held.parameter, held.value, held.parameter.default) for held in told]
        if names:
            for change in changes:
                self._link.request_parameter(change.parameter, change.after)
        else:
            self._link.command("RESET_PARAMETERS")
        self._refresh(changes)
        return changes

    def save(self) -> None:
        """Keep what is in force over a reset."""
        self._refuse_in_motion()
        try:
            self._link.command("SAVE_PARAMETERS", SAVE_S)
        except RefusedError as error:
            raise RefusedError(f"{error}{NO_MEMORY if 'UNABLE' in str(error) else ''}") from error
        self.store = self._told_store()

    def _refresh(self, changes: list[Change]) -> None:
        """Read again what was changed, and how much of it is not kept."""
        touched = {change.parameter.index for change in changes}
        self.held = [
            Held(told.parameter, read_value(self._link, told.parameter.index))
            if told.parameter.index in touched
            else told
            for told in self.held
        ]
        self.store = self._greet()

    def _refuse_in_motion(self) -> None:
        if self.moving:
            raise RefusedError(
                f"node {self._link.codec.node} is {self.moving} for another host: parameters change only at rest; "
                "end that run first"
            )
