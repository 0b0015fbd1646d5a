"""The board's own image, emulated. pytest tests/pil."""

import shutil

import pytest
from image import IMAGE_FILE

from host_sim.pil import EMULATOR


@pytest.fixture(autouse=True, scope="session")
def emulator() -> None:
    if shutil.which(EMULATOR) is None:
        pytest.fail(f"there is no {EMULATOR}: tools/setup board installs it", pytrace=False)
    if not IMAGE_FILE.exists():
        pytest.fail(f"there is no {IMAGE_FILE}: tools/build target makes it", pytrace=False)
