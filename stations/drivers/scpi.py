"""SCPI instruments through PyVISA: one session an instrument, checked after every command.

A set is sent as `COMMAND`, `*OPC?`, `SYST:ERR?`, a query as `QUERY?`, `SYST:ERR?`, each in one write:
the answer says that it is done, and an error is known at once, by the instrument's own words.
"""

import contextlib
import re
import select
import socket
import threading
import time
from functools import lru_cache
from typing import Any

import pyvisa
from pyvisa.constants import StatusCode

from protocol.errors import Fault, LinkError, LinkTimeoutError

ANSWER_GUARD_S = 20.0
"""Wall time in which an instrument answers; an emulated one may stand behind a busy bench."""
OPEN_TIMEOUT_MS = 2_000
READ_SLICE_MS = 500
"""A read is cut so: pyvisa-py notices a closed connection only between two reads."""

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
            try:
                session = self._open(command)
                session.write(text)
                answer = _read_line(session)
                error = answer if _ERROR_ENTRY.match(answer) else _read_line(session)
            except _BROKEN as broken:
                # what is still on its way would be taken for the next answer
                self.close()
                raise self._lost(command, broken) from None
            if not _NO_ERROR.match(error):
                raise LinkError(
                    f"The instrument refuses '{command}': {error}.",
                    where=self.where,
                    fault=Fault.STATION,
                    remedy="check the instrument's model against its driver, and who else uses it.",
                )
            return answer

    def _open(self, command: str) -> Any:
        if self._session is not None and _has_ended(self._session):
            self.close()
        if self._session is None:
            try:
                self._session = load_visa().open_resource(
                    self.resource,
                    read_termination="\n",
                    write_termination="\n",
                    timeout=READ_SLICE_MS,
                    open_timeout=OPEN_TIMEOUT_MS,
                )
            except Exception as error:  # noqa: BLE001 - pyvisa-py raises bare Exceptions here
                raise self._lost(command, error) from None
        return self._session

    def _lost(self, command: str, error: Exception) -> LinkError:
        kind = LinkTimeoutError if _is_timeout(error) else LinkError
        return kind(
            f"The instrument does not answer to '{command}': {' '.join(str(error).split())}.",
            where=self.where,
            fault=Fault.STATION,
            remedy="check that it is switched on and that the resource string is right (testloom doctor).",
        )


def _read_line(session: Any) -> str:
    """The next line. Raises one of _BROKEN."""
    guard = time.monotonic() + ANSWER_GUARD_S
    while True:
        try:
            return session.read().strip()
        except pyvisa.errors.VisaIOError as error:
            if not _is_timeout(error) or time.monotonic() > guard:
                raise
            if _has_ended(session):
                raise ConnectionResetError("the connection was closed") from None


def _has_ended(session: Any) -> bool:
    """Whether the instrument has closed an idle connection.

    pyvisa-py would find out by waiting for its time-out, so its socket is looked at; sessions of other
    kinds and back ends say no.
    """
    sessions = getattr(load_visa().visalib, "sessions", {})
    connection = getattr(sessions.get(session.session), "interface", None)
    if not isinstance(connection, socket.socket):
        return False
    try:
        readable = select.select([connection], [], [], 0)[0]
        return bool(readable) and not connection.recv(1, socket.MSG_PEEK)
    except OSError:
        return True


def _is_timeout(error: Exception) -> bool:
    return isinstance(error, pyvisa.errors.VisaIOError) and error.error_code == StatusCode.error_timeout
