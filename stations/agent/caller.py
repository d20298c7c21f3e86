"""Asks the coordinator: one thread for presence, one for results, so that neither waits for the other."""

import queue
import threading
from collections.abc import Callable

import structlog
from pydantic import ValidationError

from protocol.adapters.zenoh_link import NoReplyError, RequestRejectedError, ZenohLink
from protocol.frozen_model import first_problem
from protocol.keys import CoordinatorVerb, coordinator_key
from protocol.station_messages import (
    STATION_REPLY,
    RegisterStation,
    RenewLeases,
    StationReply,
    SubmitRecords,
)

ASK_TIMEOUT_S = 2.0
MAX_WAITING = 4
"""The core has one question of each kind outstanding; more would be its mistake."""

_log = structlog.get_logger("stations.agent")

_VERBS: dict[type, CoordinatorVerb] = {
    RegisterStation: "register",
    RenewLeases: "renew",
    SubmitRecords: "submit",
}

Question = RegisterStation | RenewLeases | SubmitRecords
OnAnswer = Callable[[StationReply | None], None]


class CoordinatorCaller:
    """A thread that asks one question after the other and hands each answer on; None: no answer."""

    def __init__(self, name: str, link: ZenohLink, line: str, station: str) -> None:
        self._link = link
        self._line = line
        self._station = station
        self._questions: queue.Queue[tuple[Question, OnAnswer] | None] = queue.Queue(MAX_WAITING)
        self._silent = False
        self._thread = threading.Thread(target=self._work, name=f"caller-{name}", daemon=True)
        self._thread.start()

    def ask(self, question: Question, on_answer: OnAnswer) -> None:
        """Ask soon; `on_answer` is called on the caller's thread, always, once."""
        self._questions.put((question, on_answer))

    def close(self) -> None:
        """Finish the question at hand and end."""
        self._questions.put(None)
        self._thread.join(2 * ASK_TIMEOUT_S)

    def _work(self) -> None:
        while (task := self._questions.get()) is not None:
            question, on_answer = task
            on_answer(self._answer(question))

    def _answer(self, question: Question) -> StationReply | None:
        key = coordinator_key(self._line, _VERBS[type(question)], self._station)
        try:
            payload = self._link.ask(key, question.model_dump_json().encode(), ASK_TIMEOUT_S)
            reply = STATION_REPLY.validate_json(payload)
        except NoReplyError:
            if not self._silent:
                _log.warning("coordinator_silent", question=question.kind)
            self._silent = True
            return None
        except RequestRejectedError as error:
            _log.error("question_rejected", question=question.kind, what=error.what, remedy=error.remedy)
            return None
        except ValidationError as error:
            _log.error("reply_not_understood", question=question.kind, problem=first_problem(error))
            return None
        if self._silent:
            _log.info("coordinator_answers", question=question.kind)
        self._silent = False
        return reply
