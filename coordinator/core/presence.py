"""What is known only from being in contact: who was heard of when, which socket rests.

A restart forgets all of it and gives everybody a fresh start; no fact's meaning depends on it.
"""

# pyright: strict

from collections import deque
from dataclasses import dataclass, field

from protocol.coordinator_events import LineSettings
from protocol.line_views import Alarm

MAX_ALARMS_KEPT = 200
MAX_ALARM_SUBJECTS = 5_000
MAX_REST_DOUBLINGS = 10


@dataclass(slots=True)
class Presence:
    """Contact with stations and sockets.

    Attributes:
        heard_at_s: by station, when it was last heard of.
        token_lost_at_s: by station, when its liveliness token vanished.
        silent: stations that get no work until they are heard of again.
        renewed_until_s: by fence of a live lease, when it lapses unless it is renewed.
        lingering: by socket key, the fence of a lapsed lease whose sequence may still run there.
        resting_until_s: by socket key, sockets that get no work for a while.
        trouble: by socket key, refusals and disturbed attempts in a row.
    """

    heard_at_s: dict[str, float] = field(default_factory=dict[str, float])
    token_lost_at_s: dict[str, float] = field(default_factory=dict[str, float])
    silent: set[str] = field(default_factory=set[str])
    renewed_until_s: dict[int, float] = field(default_factory=dict[int, float])
    lingering: dict[str, int] = field(default_factory=dict[str, int])
    resting_until_s: dict[str, float] = field(default_factory=dict[str, float])
    trouble: dict[str, int] = field(default_factory=dict[str, int])
    duplicates_ignored: int = 0
    alarms: deque[Alarm] = field(default_factory=lambda: deque[Alarm](maxlen=MAX_ALARMS_KEPT))
    _raised_at_s: dict[tuple[str, str], float] = field(default_factory=dict[tuple[str, str], float])

    def forget(self) -> None:
        """A new process begins: only counters and alarms for the view stay."""
        for known in (self.heard_at_s, self.token_lost_at_s, self.renewed_until_s, self.lingering):
            known.clear()
        self.silent.clear()
        self.resting_until_s.clear()
        self.trouble.clear()

    def rest_of(self, socket_key: str, settings: LineSettings, tolerated: int) -> float:
        """Count one more trouble at a socket; how long it shall rest now.

        Args:
            socket_key: the socket.
            settings: `refusal_rest_s` doubles up to `rest_limit_s`.
            tolerated: troubles in a row that lead to no rest yet.
        """
        count = self.trouble[socket_key] = self.trouble.get(socket_key, 0) + 1
        if count <= tolerated:
            return 0.0
        doublings = min(count - tolerated - 1, MAX_REST_DOUBLINGS)
        return min(settings.refusal_rest_s * 2.0**doublings, settings.rest_limit_s)

    def new_alarm(
        self, at_s: float, alarm: str, subject: str, template: str, values: dict[str, str], repeat_s: float
    ) -> Alarm | None:
        """The alarm, unless the same one about the same subject was raised within `repeat_s`."""
        last_s = self._raised_at_s.get((alarm, subject))
        if last_s is not None and at_s - last_s < repeat_s:
            return None
        if len(self._raised_at_s) >= MAX_ALARM_SUBJECTS:
            self._raised_at_s.clear()
        self._raised_at_s[alarm, subject] = at_s
        raised = Alarm(
            raised_at_s=at_s,
            alarm=alarm,
            subject=subject,
            text=template.format(**values),
            template=template,
            values=values,
        )
        self.alarms.append(raised)
        return raised
