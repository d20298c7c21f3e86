"""Units and their flash: made from seed and serial number, their flash kept between benches.

`<units-dir>/<serial>.json` is what a real unit carries from one bench to the next in its own flash. It is
written atomically as soon as the unit has changed it, so that the death of a bench loses nothing. Only
benches read this directory; stations have no business there.
"""

import json
import os
import re
from pathlib import Path
from typing import Any

from dut_emulator.interfaces import EmulatedUnit
from dut_emulator.products.catalogue import make_unit
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError

MAX_SERIAL_LENGTH = 32
MAX_FLASH_BYTES = 1_000_000
_SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


class UnitStore:
    """Makes units and keeps their flash.

    Raises:
        TestloomError: the directory cannot be used.
    """

    def __init__(
        self, directory: Path, seed: int, product: str = "gnc_module", twin: Twin | None = None
    ) -> None:
        self._directory = directory
        self._seed = seed
        self._product = product
        self._twin = twin
        self._saved: dict[str, dict[str, Any]] = {}
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if not os.access(directory, os.R_OK | os.W_OK | os.X_OK):
                raise PermissionError("no permission to read and write there")
        except OSError as error:
            raise TestloomError(
                f"The directory of the units' flash cannot be used: {error}.",
                where=str(directory),
                fault=Fault.OPERATOR,
                remedy="give --units-dir a directory that the bench may write to.",
            ) from None

    def make(self, serial: str) -> EmulatedUnit:
        """The unit with this serial number, with the flash it had last.

        Raises:
            TestloomError: it is no serial number, or the flash cannot be read.
        """
        if len(serial) > MAX_SERIAL_LENGTH or not _SERIAL.fullmatch(serial):
            raise TestloomError(
                f"'{serial[:40]}' is no serial number.",
                where="control channel, insert",
                fault=Fault.OPERATOR,
                remedy=f"give 1 to {MAX_SERIAL_LENGTH} letters, digits, dots, dashes or underscores.",
            )
        flash = self._read(serial)
        try:
            unit = make_unit(self._product, self._seed, serial, flash, self._twin)
        except (KeyError, TypeError, ValueError) as error:
            raise self._damaged(serial, f"{type(error).__name__} {error}") from None
        self._saved[serial] = flash or {}
        return unit

    def keep(self, serial: str, unit: EmulatedUnit) -> None:
        """Write a unit's flash, if it is not as it was written last.

        Raises:
            TestloomError: it cannot be written.
        """
        image = unit.flash_image()
        if image == self._saved.get(serial):
            return
        path = self._path(serial)
        try:
            write_atomically(path, json.dumps(image, indent=1))
        except OSError as error:
            raise TestloomError(
                f"The flash of unit {serial} cannot be written: {error}.",
                where=str(path),
                fault=Fault.STATION,
                remedy="free disk space or give --units-dir another directory.",
            ) from None
        self._saved[serial] = image

    def _read(self, serial: str) -> dict[str, Any] | None:
        path = self._path(serial)
        try:
            if path.stat().st_size > MAX_FLASH_BYTES:
                raise ValueError(f"larger than {MAX_FLASH_BYTES} bytes")
            image = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(image, dict):
                raise ValueError("no JSON object")
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise self._damaged(serial, str(error)) from None
        return image

    def _damaged(self, serial: str, why: str) -> TestloomError:
        return TestloomError(
            f"The flash of unit {serial} cannot be read: {why}.",
            where=str(self._path(serial)),
            fault=Fault.DATA,
            remedy="restore the file, or remove it to have the unit as it left the factory.",
        )

    def _path(self, serial: str) -> Path:
        return self._directory / f"{serial}.json"


def write_atomically(path: Path, text: str) -> None:
    """Replace a file so that a reader sees the old or the new text, never a part."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
