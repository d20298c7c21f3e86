"""Simulated time, and the network between stations and coordinator.

The network loses, duplicates and delays each message by its own draw, so messages overtake each
other; some are held back for seconds, across time-outs and restarts. A partitioned station is
reached by nothing. A query is a message there and a message back, with the asker's time-out.
"""

# pyright: strict

import random
from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Any

ASK_TIMEOUT_S = 1.0
MAX_EVENTS = 5_000_000


@dataclass(frozen=True)
class NetworkFaults:
    """Probabilities per message; `held_back` ones are late by up to `held_back_s`."""

    loss: float = 0.0
    duplication: float = 0.0
    held_back: float = 0.0
    held_back_s: float = 12.0
    latency_s: float = 0.02


class World:
    """Time, chance and the network of one simulation."""

    def __init__(self, seed: int, faults: NetworkFaults) -> None:
        self.random = random.Random(seed)
        self.faults = faults
        self.now_s = 0.0
        self.partitioned: set[str] = set()
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0

    def at(self, at_s: float, action: Callable[[], None]) -> None:
        """Do something at a time, at the earliest now."""
        self._count += 1
        heappush(self._agenda, (max(at_s, self.now_s), self._count, action))

    def after(self, delay_s: float, action: Callable[[], None]) -> None:
        """Do something after a while."""
        self.at(self.now_s + delay_s, action)

    def run(self, until: Callable[[], bool], limit_s: float) -> bool:
        """Let time pass until the condition holds; False if it does not by `limit_s`."""
        for _ in range(MAX_EVENTS):
            if until():
                return True
            if not self._agenda or self._agenda[0][0] > limit_s:
                return False
            self.now_s, _, action = heappop(self._agenda)
            action()
        return False

    def heal(self) -> None:
        """From now on the network is sound. What is under way stays under way."""
        self.partitioned.clear()
        self.faults = NetworkFaults()

    def send(self, station: str, deliver: Callable[[], None]) -> None:
        """One message from or to a station."""
        faults, chance = self.faults, self.random
        copies = 2 if faults.duplication and chance.random() < faults.duplication else 1
        for _ in range(copies):
            if station in self.partitioned or (faults.loss and chance.random() < faults.loss):
                continue
            delay_s = faults.latency_s * chance.random()
            if faults.held_back and chance.random() < faults.held_back:
                delay_s = faults.held_back_s * chance.random()
            self.after(delay_s, deliver)

    def ask(
        self,
        station: str,
        question: Callable[[Callable[[Any], None]], None],
        answered: Callable[[Any], None],
        unanswered: Callable[[], None] = lambda: None,
    ) -> None:
        """A query from or to a station; exactly one of `answered` and `unanswered` is called.

        Args:
            station: whose link the messages take.
            question: runs at the far end, and is given the function to answer with.
            answered: the first answer that comes within the time-out.
            unanswered: there was none.
        """
        open_question = [True]

        def close(finish: Callable[[], None]) -> None:
            if open_question[0]:
                open_question[0] = False
                finish()

        def answer(reply: Any) -> None:
            self.send(station, lambda: close(lambda: answered(reply)))

        self.send(station, lambda: question(answer))
        self.after(ASK_TIMEOUT_S, lambda: close(unanswered))
