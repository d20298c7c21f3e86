"""What a table over temperature makes of an emulated unit's accelerometers: paper 2's 5 mg.

The table is fitted here by hand from poses in 5 °C steps, written in the firmware's form, and tried at other
poses and temperatures: as in the paper, with the matrix of room temperature and σ(T) on the sensor's output.
"""

import dataclasses

import numpy as np

from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.products.mems_ahrs.compensation import Node, TriadCompensation
from dut_emulator.products.mems_ahrs.unit_effects import draw_twin

G = 9.80665
ROOM_C = 25.0
NODES_C = np.arange(-40.0, 71.0, 5.0)
WITHOUT = (
    *("warm_up", "thermal_hysteresis", "bandwidth", "fixed_delay"),
    *("white_noise", "bias_instability", "quantization"),
)
"""What a mean at rest does not have, or what belongs to a history: half a milli-g."""


def means(chain: EffectChain, forces: np.ndarray, temperature_c: float) -> np.ndarray:
    """(m, 3) outputs at rest in m poses."""
    times, at = np.arange(len(forces)) / 200.0, np.full(len(forces), temperature_c)
    acting = Stimulus(times, at, 1 / 200.0, specific_force_m_s2=forces)
    return chain.apply(forces, acting, chain.begin(np.random.SeedSequence(1)))


def poses() -> np.ndarray:
    """Eight directions in each of the three planes."""
    turn = np.arange(8) * np.pi / 4
    circle = G * np.stack([np.cos(turn), np.sin(turn), np.zeros(8)], axis=1)
    return np.concatenate([np.roll(circle, shift, axis=1) for shift in range(3)])


def fitted(chain: EffectChain) -> TriadCompensation:
    forces = poses()
    room = means(chain, forces, ROOM_C)
    design = np.column_stack([forces, np.ones(len(forces))])
    solution = np.linalg.lstsq(design, room, rcond=None)[0]
    matrix, bias = solution[:3].T, solution[3]
    nodes = []
    for node_c in NODES_C:
        output = means(chain, forces, float(node_c))
        numbers = [np.polyfit(output[:, axis], output[:, axis] - room[:, axis], 2) for axis in range(3)]
        nodes.append(Node(float(node_c), tuple(np.concatenate(numbers).tolist())))
    inverse = np.linalg.inv(matrix).ravel()
    return TriadCompensation(tuple(inverse.tolist()), tuple(bias.tolist()), tuple(nodes))


def test_the_worst_error_falls_to_the_papers_five_milli_g() -> None:
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((10, 3))
    forces = G * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    worst_before: list[float] = []
    for number in range(12):
        twin = draw_twin(1, f"U-{30 * number:04d}")
        kept = tuple(effect for effect in twin.effects if effect.word not in WITHOUT)
        chain = dataclasses.replace(twin, effects=kept).chain("acc")
        table = fitted(chain)
        room_only = dataclasses.replace(table, nodes=())
        before, after = [], []
        for temperature_c in (-38.3, -12.1, 8.4, 41.7, 66.6):
            output = means(chain, forces, temperature_c)
            at = np.full(len(output), temperature_c)
            before.append(np.abs(room_only.apply(output, at) - forces).max() / G)
            after.append(np.abs(table.apply(output, at) - forces).max() / G)
        assert max(after) < 5e-3
        assert max(before) > 3 * max(after)
        worst_before.append(max(before))
    assert np.median(worst_before) > 15e-3
