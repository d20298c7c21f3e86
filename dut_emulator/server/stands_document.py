"""Writes docs/stands.md: what every stand's command port answers, from the ports themselves.

python -m dut_emulator.server.stands_document > docs/stands.md
"""

import sys
from importlib import import_module

from dut_emulator.server.bench_kinds import BENCH_KINDS, WIRING, Instrument, Wiring
from dut_emulator.server.link_faults import Framing
from dut_emulator.stands.catalogue import STANDS, live_stand
from protocol.bench_description import Site

_SITE = Site(latitude_deg=40.0, gravity_m_s2=9.8)
_HEAD = """# Stands and their command ports

Written by `python -m dut_emulator.server.stands_document > docs/stands.md`; a test holds it to the code.

Every stand is served by `testloom bench --kind KIND`: its command port (TCP, one command a line), its stream
(TCP, samples without framing) and the unit's own links or instruments; the bench's description says where.
What all benches have in common is in [bench.md](bench.md).

| kind | products |
|---|---|
"""
_WIRING_HEAD = """
| product | supply | how a stand connects it |
|---|---|---|
"""
_INSTRUMENTS: dict[Instrument, str] = {
    "serial_multimeter": "its analogue outputs to the serial multimeter",
    "pulse_counter": "its pulse outputs to the pulse counter",
}
_FRAMINGS = {Framing.RS422: "frames of `protocol/frames.py`", Framing.UNFRAMED: "frames of its own"}


def stands_document() -> str:
    """The whole document."""
    sections: dict[str, list[str]] = {}
    for kind in STANDS:
        module = type(live_stand(kind, 1, _SITE, "ID").port).__module__
        sections.setdefault(module, []).append(kind)
    rows = [f"| `{kind}` | {', '.join(BENCH_KINDS[kind].products)} |\n" for kind in STANDS]
    wires = [
        f"| {product} | {wiring.supply_v:g} V | {_connection(wiring)} |\n"
        for product, wiring in WIRING.items()
    ]
    texts = [
        f"\n## {', '.join(f'`{kind}`' for kind in kinds)}\n{_text_of(module)}\n"
        for module, kinds in sections.items()
    ]
    return "".join([_HEAD, *rows, _WIRING_HEAD, *wires, *texts])


def _connection(wiring: Wiring) -> str:
    if wiring.instrument is not None:
        return _INSTRUMENTS[wiring.instrument]
    return "; ".join(f"`1.{link}`: {_FRAMINGS[framing]}" for link, framing in wiring.links)


def _text_of(module: str) -> str:
    """A module's docstring as Markdown."""
    return (import_module(module).__doc__ or "").strip()


if __name__ == "__main__":
    sys.stdout.write(stands_document())
