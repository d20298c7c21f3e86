# pyright: strict
"""Where the units of a bench sit: on a level socket board, or on a stand's table."""

from dut_emulator.interfaces import Surroundings
from dut_emulator.server.bench_model import StandModel
from dut_emulator.server.configuration import BenchServerConfiguration
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.three_axis_turntable import EncoderErrors, ThreeAxisTurntableModel
from dut_emulator.stands.turntable_commands import TurntablePort


def surroundings_of(configuration: BenchServerConfiguration) -> tuple[StandModel | None, Surroundings]:
    """The bench's stand, if it has one, and what acts on its units."""
    if configuration.kind == "socket_board":
        return None, LevelBoard(configuration.site)
    table = ThreeAxisTurntableModel(
        configuration.site, encoders=EncoderErrors(seed=configuration.instrument_seed)
    )
    return TurntablePort(table, f"Testloom,TT3,{configuration.bench_identity},1.0"), table
