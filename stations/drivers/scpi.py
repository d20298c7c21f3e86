"""SCPI instruments through PyVISA: one session an instrument, checked after every command.

A set is sent as `COMMAND`, `*OPC?`, `SYST:ERR?`, a query as `QUERY?`, `SYST:ERR?`, each in one write:
the answer says that it is done, and an error is known at once, by the instrument's own words.
"""

import contextlib
import re
import threading
from functools import lru_cache
from typing import Any

import pyvisa
from pyvisa.constants import StatusCode

from protocol.errors import Fault, LinkError, LinkTimeoutError

VISA_TIMEOUT_MS = 2_000
MAX_TRIES = 2
"""A command on a session that broke is sent once more on a new one (all commands may be repeated)."""

_ERROR_ENTRY = re.compile(r'^[+-]?\d+,".*"$')
_NO_ERROR = re.compile(r'^[+-]?0,"')
_BROKEN = (pyvisa.errors.VisaIOError, pyvisa.errors.InvalidSession, OSError, ValueError)


@lru_cache(maxsize=1)
def load_visa() -> pyvisa.ResourceManager:
    """PyVISA's resource manager with the pure-Python backend: one for the process."""
    return pyvisa.ResourceManager("@py")


class ScpiSession:
    """One instrument. Any thread may use it; it opens when first used, and again after a failure."""

    def __init__(self, resource: str, name: str) -> None:
        self.resource = resource
        self.name = name
        self._lock = threading.RLock()
        self._session: Any = None

    @property
    def where(self) -> str:
        return f"{self.name}, {self.resource}"

    def set(self, command: str) -> None:
        """A command without an answer; returns when the instrument has done it.

        Raises:
            LinkError: the instrument refuses it, or cannot be reached.
        """
        self._exchange(command, f"{command}\n*OPC?\nSYST:ERR?")

    def query(self, query: str) -> str:
        """The answer to a query.

        Raises:
            LinkError: the instrument refuses it, or cannot be reached.
        """
        return self._exchange(query, f"{query}\nSYST:ERR?")

    def query_number(self, query: str) -> float:
        """The answer to a query, as a number. Raises as `query`."""
        answer = self.query(query)
        try:
            return float(answer)
        except ValueError:
            raise LinkError(
                f"The instrument answered '{answer}' to {query}, which is no number.",
                where=self.where,
                fault=Fault.STATION,
                remedy="check that the resource string names the right instrument.",
            ) from None

    def identify(self) -> str:
        """The instrument's answer to *IDN?. Raises as `query`."""
        return self.query("*IDN?")

    def close(self) -> None:
        """Close the session; the next use opens it again."""
        with self._lock:
            session, self._session = self._session, None
            if session is not None:
                with contextlib.suppress(*_BROKEN):
                    session.close()

    def _exchange(self, command: str, text: str) -> str:
        """The first answer to `text`, whose last line asks for the error queue."""
        with self._lock:
            for trial in range(1, MAX_TRIES + 1):
                fresh = self._session is None
                try:
                    session = self._open()
                    session.write(text)
                    answer = session.read().strip()
                    error = answer if _ERROR_ENTRY.match(answer) else session.read().strip()
                except _BROKEN as broken:
                    self.close()
                    if fresh or trial == MAX_TRIES or _is_timeout(broken):
                        raise self._lost(command, broken) from None
                    continue
                if not _NO_ERROR.match(error):
                    raise LinkError(
                        f"The instrument refuses '{command}': {error}.",
                        where=self.where,
                        fault=Fault.STATION,
                        remedy="check the instrument's model against its driver, and who else uses it.",
                    )
                return answer
        raise AssertionError("unreachable: the last try returns or raises")

    def _open(self) -> Any:
        if self._session is None:
            self._session = load_visa().open_resource(
                self.resource,
                read_termination="\n",
                write_termination="\n",
                timeout=VISA_TIMEOUT_MS,
                open_timeout=VISA_TIMEOUT_MS,
            )
        return self._session

    def _lost(self, command: str, error: Exception) -> LinkError:
        kind = LinkTimeoutError if _is_timeout(error) else LinkError
        return kind(
            f"The instrument does not answer to '{command}': {' '.join(str(error).split())}.",
            where=self.where,
            fault=Fault.STATION,
            remedy="check that it is switched on and that the resource string is right (testloom doctor).",
        )


def _is_timeout(error: Exception) -> bool:
    return isinstance(error, pyvisa.errors.VisaIOError) and error.error_code == StatusCode.error_timeout
