# pyright: strict
"""Where the units of a bench sit: on a level socket board, or on a stand."""

from dut_emulator.interfaces import Surroundings
from dut_emulator.server.bench_kinds import SOCKET_BOARD
from dut_emulator.server.configuration import BenchServerConfiguration
from dut_emulator.stands.catalogue import live_stand
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.recording_stand import LiveStand


def surroundings_of(configuration: BenchServerConfiguration) -> tuple[LiveStand | None, Surroundings]:
    """The bench's stand, if it has one, and what acts on its units."""
    if configuration.kind == SOCKET_BOARD:
        return None, LevelBoard(configuration.site)
    seed, identity = configuration.instrument_seed, configuration.bench_identity
    stand = live_stand(configuration.kind, seed, configuration.site, identity)
    return stand, stand.surroundings
