"""The flash sectors of the kept parameters: where the image is told they are, and that no image gets into them."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "firmware" / "ports" / "stm32f405" / "stm32f405.ld"
IMAGE = ROOT / "build" / "target" / "omnibot.elf"
SECTOR_10 = 0x080C_0000  # RM0090, table 5: 128 kB, and sector 11 behind it


def link(folder: Path, constants: int) -> subprocess.CompletedProcess[str]:
    """Link a program with so many bytes of constants by the board's script."""
    source = folder / "program.c"
    source.write_text(
        "void reset_handler(void) {}\n"
        '__attribute__((section(".vectors"), used)) static void (*const vectors[2])(void) = {0, reset_handler};\n'
        f'__attribute__((section(".rodata"), used)) static const char constants[{constants}] = {{1}};\n'
    )
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-nostdlib", f"-T{SCRIPT}", str(source)]
    return subprocess.run([*command, "-o", str(folder / "a.elf")], capture_output=True, text=True, check=False)


def test_image_finds_the_sectors_at_their_address() -> None:
    assert IMAGE.exists(), "there is no board image: tools/build target makes it"
    symbols = subprocess.run(["arm-none-eabi-nm", IMAGE], capture_output=True, text=True, check=True).stdout
    assert f"{SECTOR_10:08x} A settings_sectors" in symbols


def test_image_up_to_the_sectors_links(tmp_path: Path) -> None:
    made = link(tmp_path, SECTOR_10 - 0x0800_0000 - 64)
    assert made.returncode == 0, made.stderr


@pytest.mark.parametrize("constants", [SECTOR_10 - 0x0800_0000, 1000 * 1024])
def test_image_that_reaches_the_sectors_does_not_link(tmp_path: Path, constants: int) -> None:
    made = link(tmp_path, constants)
    assert made.returncode != 0
    assert "will not fit in region `FLASH'" in made.stderr
