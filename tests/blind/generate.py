"""Write a set of cases: recordings for the engine in one place, sealed labels in another.

Cases of one excitation instance are made together, since its columns cost more than a case.
"""

import hashlib
import json
import shutil
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.case_plan import CaseSpec, plan, real_noise_folder
from tests.blind.catalogue import Catalogue
from tests.blind.effect_shapes import SHAPES, TRIADS
from tests.blind.excitations import Excitation, excitation
from tests.blind.hidden_signals import Hidden, foreign, scaled_outside, single
from tests.blind.metric import Metric
from tests.blind.noise import ChannelNoise
from tests.blind.oracle import judged
from tests.blind.random_effects import DISCRETE_CHANGES, STOCHASTIC, amount_for, louder
from tests.blind.units import Unit, drawn_unit, recorded, write_case

Array = NDArray[np.float64]

MANIFEST = "cases.json"
MAX_TRIES = 15
_EVERYWHERE = tuple(name for name in SHAPES if name != "stand.earth_rate")


@dataclass
class Case:
    """Everything of one case in memory."""

    spec: CaseSpec
    unit: Unit
    metric: Metric
    noise: dict[str, Array]
    hidden: list[Hidden]
    without: tuple[str, ...] = ()
    discrete: str = ""


def case_rng(seed: int, number: int) -> np.random.Generator:
    """The source of all draws of a case."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 2, number))))


def drawn_noise(
    rng: np.random.Generator, test: Excitation, noise: dict[str, ChannelNoise]
) -> dict[str, Array]:
    """One realisation for each channel, runs independent of each other."""
    return {c: np.concatenate([one.drawn(rng, run.rows) for run in test.runs]) for c, one in noise.items()}


def make_case(spec: CaseSpec, seed: int, test: Excitation, catalogue: Catalogue) -> Case:
    """The case of a spec; another effect takes the place of one that this excitation cannot show."""
    rng = case_rng(seed, spec.number)
    unit = drawn_unit(rng, test)
    case = Case(spec, unit, Metric(test, unit.noise), {}, [])
    makers = {"single": _single, "pair": _pair, "out_of_catalogue": _foreign, "decoy": _foreign,
              "decoy_stand": _single, "withheld": _withheld, "discrete": _discrete}  # fmt: skip
    if spec.kind == "semi_real":
        _on_real_noise(rng, case, test)
        case.hidden = [_visible(rng, case, test, name) for name in spec.effects]
        return case
    if spec.kind == "null" and rng.random() < 0.2:
        case.without = (str(rng.choice(sorted(_EVERYWHERE))),)
    if spec.kind != "null":
        makers[spec.kind](rng, case, test, catalogue)
    case.noise = drawn_noise(rng, test, case.unit.noise)
    return case


def _visible(rng: np.random.Generator, case: Case, test: Excitation, name: str) -> Hidden:
    """`name` at the wanted d, or the first of random others that the excitation shows."""
    for candidate in (name, *rng.permutation(_EVERYWHERE)):
        hidden = single(rng, test, case.metric, str(candidate), case.spec.d)
        if hidden is not None:
            return hidden
    raise AssertionError(f"{test.kind} shows no effect at all")


def _single(rng: np.random.Generator, case: Case, test: Excitation, catalogue: Catalogue) -> None:
    name = case.spec.effects[0]
    if name in STOCHASTIC and _louder(rng, case, test, name):
        return
    if name == "stand.earth_rate" and _earth_rate(rng, case, test):
        return
    name = name if name not in (*STOCHASTIC, "stand.earth_rate") else str(rng.choice(_EVERYWHERE))
    case.hidden = [_visible(rng, case, test, name)]


def _earth_rate(rng: np.random.Generator, case: Case, test: Excitation) -> bool:
    """Earth turns at its own rate: the unit's noise is chosen to give d."""
    nominal = single(rng, test, case.metric, "stand.earth_rate", 1.0)
    if nominal is None:
        return False
    louder_by = 1 / nominal.facts["scale"] / case.spec.d
    if not 0.05 < louder_by < 30:
        return False
    case.unit.scale_gyro_noise(louder_by)
    case.metric = Metric(test, case.unit.noise)
    hidden = single(rng, test, case.metric, "stand.earth_rate", case.spec.d)
    assert hidden is not None
    case.hidden = [hidden]
    return True


def _louder(rng: np.random.Generator, case: Case, test: Excitation, name: str) -> bool:
    """Raise a unit's noise; False where no plausible amount gives d."""
    triad, part = STOCHASTIC[name]
    channels = TRIADS[triad]
    if channels[0] not in case.unit.noise:
        return False
    chosen = channels if rng.random() < 0.4 else (channels[int(rng.integers(3))],)
    rows = [run.rows for run in test.runs]
    believed = case.unit.believed_noise[chosen[0]]
    amount = amount_for(believed, case.unit.spreads[triad], part, case.spec.d, rows)
    if amount is None:
        return False
    for channel in chosen:
        case.unit.noise[channel] = louder(case.unit.noise[channel], part, amount)
    case.metric = Metric(test, case.unit.noise)
    facts = {"effect": name, "amount": amount, "channels": list(chosen)}
    case.hidden = [Hidden({}, case.spec.d, facts)]
    return True


def _pair(rng: np.random.Generator, case: Case, test: Excitation, catalogue: Catalogue) -> None:
    first = _visible(rng, case, test, case.spec.effects[0])
    for candidate in (case.spec.effects[1], *rng.permutation(_EVERYWHERE)):
        if candidate in (first.facts["effect"], "stand.earth_rate"):
            continue
        second = single(rng, test, case.metric, str(candidate), case.spec.d)
        if second is not None:
            case.hidden = [first, second]
            return


def _foreign(rng: np.random.Generator, case: Case, test: Excitation, catalogue: Catalogue) -> None:
    others = ("bump_in_time", "telegraph_bias")
    if case.spec.kind == "decoy":
        others = (
            "mag_follows_supply",
            "acc_follows_rate",
            "mag_follows_force",
            "acc_follows_temperature_rate",
        )
    for name in (case.spec.effects[0],) * 3 + others * 4:
        hidden = foreign(rng, test, case.metric, catalogue, name, case.spec.d)
        if hidden is not None:
            case.hidden = [hidden]
            return
    raise AssertionError(f"no foreign signal for {test.kind}")


def _withheld(rng: np.random.Generator, case: Case, test: Excitation, catalogue: Catalogue) -> None:
    for candidate in (case.spec.effects[0], *rng.permutation(_EVERYWHERE)):
        name = str(candidate)
        drawn = single(rng, test, case.metric, name, 1.0) if name != "stand.earth_rate" else None
        if drawn is None:
            continue
        hidden = scaled_outside(case.metric, catalogue, name, drawn.signal, case.spec.d, (name,))
        limit = SHAPES[name].limit
        if hidden is None or not _within(drawn, hidden.facts["scale"], limit):
            continue
        hidden.facts = {**drawn.facts, **hidden.facts}
        case.hidden, case.without = [hidden], (name,)
        return
    raise AssertionError(f"no effect to withhold for {test.kind}")


def _within(drawn: Hidden, scale: float, limit: float) -> bool:
    values = [v for one in drawn.facts.get("coefficients", []) for v in one["values"]]
    return scale * float(np.linalg.norm(values)) <= limit


def _discrete(rng: np.random.Generator, case: Case, test: Excitation, catalogue: Catalogue) -> None:
    case.discrete = case.spec.effects[0]
    case.hidden = [Hidden({}, 0.0, {"effect": case.discrete})]


def _on_real_noise(rng: np.random.Generator, case: Case, test: Excitation) -> None:
    """Noise of the real static record, half of it in each run; believed noise as its README says."""
    folder = real_noise_folder()
    assert folder is not None
    believed = json.loads((folder / "recording.json").read_text(encoding="utf-8"))["believed"]
    rows = test.runs[0].rows
    with np.load(folder / "dut.npz") as columns:
        for channel in case.unit.noise:
            real = columns[channel].astype(float)[: 4 * rows].reshape(2, rows, 2).mean(axis=2)
            real -= real.mean(axis=1, keepdims=True)
            case.noise[channel] = real.ravel()
            white = float(np.std(np.diff(real, axis=1))) / np.sqrt(2)
            slow = np.sqrt(max(float(real[:, : rows // 500 * 500].reshape(2, -1, 500).mean(axis=2).var())
                               - white**2 / 500, 1e-4 * white**2))  # fmt: skip
            case.unit.noise[channel] = ChannelNoise(test.runs[0].rate_hz, white, ((slow, 100.0),))
            case.unit.quanta[channel] = 0.0
    for triad in ("gyro", "acc"):
        words = case.unit.believed[triad]
        for word in ("angle_random_walk", "velocity_random_walk", "bias_instability", "quantum"):
            words.pop(word, None)
            if word in believed[triad] and word != "quantum":
                words[word] = believed[triad][word]
    case.unit.serial = "S-mpu6050-1"
    case.metric = Metric(test, case.unit.noise)


def test_of(spec: CaseSpec, seed: int, size: str) -> Excitation:
    """The excitation instance of a spec; shorter in a quick set."""
    if spec.kind == "semi_real":
        return excitation(spec.excitation, (seed, 3, spec.instance), carrier=(50.0, 11000))
    return excitation(spec.excitation, (seed, 4, spec.instance), stretch=0.6 if size == "quick" else 1.0)


def write(case: Case, test: Excitation, seed: int, out: Path, catalogue: Catalogue) -> dict[str, Any]:
    """Write a case's recordings; its label."""
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 5, case.spec.number))))
    signal: dict[str, Array] = {}
    for hidden in case.hidden:
        for channel, wave in hidden.signal.items():
            signal[channel] = signal.get(channel, 0) + wave
    frames = recorded(rng, case.unit, test, signal, case.noise)
    if case.discrete:
        for one in frames:
            DISCRETE_CHANGES[case.discrete](rng, one, case.unit.noise)
    write_case(out / case_name(case.spec), case.unit, test, frames)
    label: dict[str, Any] = {
        "case": case_name(case.spec), "kind": case.spec.kind, "excitation": test.kind,
        "instance": case.spec.instance, "runs": len(test.runs), "rows": test.rows,
        "wanted": {"effects": list(case.spec.effects), "d": case.spec.d},
        "effects": [hidden.facts["effect"] for hidden in case.hidden],
        "d": [hidden.d for hidden in case.hidden], "facts": [hidden.facts for hidden in case.hidden],
        "without": list(case.without),
    }  # fmt: skip
    label["oracle"] = judged(case, test, catalogue)
    return label


def case_name(spec: CaseSpec) -> str:
    """Says nothing about the label."""
    return f"case-{spec.number:05d}"


def _group(arguments: tuple[list[CaseSpec], int, str, Path, Path]) -> list[dict[str, Any]]:
    specs, seed, size, out, labels = arguments
    test = test_of(specs[0], seed, size)
    catalogue = Catalogue(test)
    entries = []
    for spec in specs:
        case = make_case(spec, seed, test, catalogue)
        text = json.dumps(write(case, test, seed, out, catalogue), indent=1, default=float)
        (labels / f"{case_name(spec)}.json").write_text(text, encoding="utf-8")
        seal = hashlib.sha256(text.encode()).hexdigest()
        entries.append({"case": case_name(spec), "without": list(case.without), "seal": seal})
    return entries


def groups(specs: Iterable[CaseSpec]) -> list[list[CaseSpec]]:
    """Specs that share an excitation instance; semi-real ones have their own, whose noise sets the rate."""
    shared: dict[tuple[str, int, bool], list[CaseSpec]] = {}
    for spec in specs:
        if spec.kind == "semi_real":
            spec = replace(spec, excitation=("tumble", "swing")[spec.instance % 2])
        shared.setdefault((spec.excitation, spec.instance, spec.kind == "semi_real"), []).append(spec)
    return sorted(shared.values(), key=len, reverse=True)


def generate(
    out: Path, labels: Path, *, size: str = "default", seed: int = 1, cases: int | None = None,
    part: tuple[int, int] = (0, 1), workers: int = 1,
) -> int:  # fmt: skip
    """Write a set, or every `part[1]`-th group of it. Returns the number of cases."""
    for folder in (out, labels):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    chosen = groups(plan(size, seed, cases))[part[0] :: part[1]]
    jobs = [(specs, seed, size, out, labels) for specs in chosen]
    if workers > 1:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            entries = [entry for group in pool.map(_group, jobs) for entry in group]
    else:
        entries = [entry for job in jobs for entry in _group(job)]
    entries.sort(key=lambda entry: entry["case"])
    (out / MANIFEST).write_text(json.dumps({"seed": seed, "size": size, "cases": entries}, indent=1))
    return len(entries)
