"""The table of metrics: each with its 95 % bounds and its goal, beside the oracle and two baselines."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import betaincinv

from tests.blind.case_plan import LADDER
from tests.blind.next_tests import kind_of
from tests.blind.parameters import normalised_errors
from tests.blind.verdicts import Judged

RECORDING_OF_THE_GOAL_ROWS = 3600 * 200
CORES = 2
KINDS_OF_CASES = (
    *("null", "single", "discrete", "pair", "out_of_catalogue"),
    *("decoy", "decoy_stand", "withheld", "semi_real"),
)


@dataclass(frozen=True)
class Row:
    """A figure. `state`: met, short (its bounds exclude the goal), open (they do not), or empty: no goal."""

    metric: str
    value: float | None
    low: float | None
    high: float | None
    cases: int
    goal: str
    state: str
    oracle: float | None = None
    bic: float | None = None
    unwhitened: float | None = None


def clopper_pearson(hits: int, cases: int) -> tuple[float, float]:
    """Exact 95 % bounds of a fraction."""
    low = 0.0 if hits == 0 else float(betaincinv(hits, cases - hits + 1, 0.025))
    high = 1.0 if hits == cases else float(betaincinv(hits + 1, cases - hits, 0.975))
    return low, high


def _state(value: float, low: float, high: float, at_least: float | None, at_most: float | None) -> str:
    floor, ceiling = -np.inf if at_least is None else at_least, np.inf if at_most is None else at_most
    if not (np.isfinite(floor) or np.isfinite(ceiling)):
        return ""
    if floor - 1e-9 <= value <= ceiling + 1e-9:
        return "met"
    return "short" if high < floor or low > ceiling else "open"


def _goal(at_least: float | None, at_most: float | None, shown: Callable[[float], str]) -> str:
    limits = (("≥", at_least), ("≤", at_most))
    return " ".join(f"{sign} {shown(limit)}" for sign, limit in limits if limit is not None)


def fraction(
    metric: str, right: Iterable[bool], *, at_least: float | None = None, at_most: float | None = None,
    **beside: float | None,
) -> Row:  # fmt: skip
    """A row for a fraction of cases."""
    hits = [bool(one) for one in right]
    goal = " ".join(
        f"{sign} {100 * limit:.1f} %"
        for sign, limit in (("≥", at_least), ("≤", at_most))
        if limit is not None
    )
    if not hits:
        return Row(metric, None, None, None, 0, goal, "", **beside)
    low, high = clopper_pearson(sum(hits), len(hits))
    value = sum(hits) / len(hits)
    return Row(
        metric, value, low, high, len(hits), goal, _state(value, low, high, at_least, at_most), **beside
    )


def statistic(
    metric: str, samples: Sequence[Any], of: Callable[[np.ndarray], float], *,
    at_least: float | None = None, at_most: float | None = None, **beside: float | None,
) -> Row:  # fmt: skip
    """A row for a figure of several cases, with bootstrap bounds."""
    goal = _goal(at_least, at_most, lambda limit: f"{limit:.3g}")
    if not len(samples):
        return Row(metric, None, None, None, 0, goal, "", **beside)
    data = np.asarray(samples, dtype=float)
    rng = np.random.Generator(np.random.Philox(7))
    again = [of(data[rng.integers(len(data), size=len(data))]) for _ in range(400)]
    low, high = (float(x) for x in np.quantile(again, [0.025, 0.975]))
    value = of(data)
    return Row(
        metric, value, low, high, len(data), goal, _state(value, low, high, at_least, at_most), **beside
    )


def _mean(right: Sequence[bool]) -> float | None:
    return float(np.mean(right)) if len(right) else None


def _nominal_d(one: Judged) -> float:
    """The ladder's step: thresholds reach it only nearly."""
    return min(LADDER, key=lambda d: abs(np.log(d / max(one.label["d"][0], 1e-9))))


def _top(one: Judged, count: int) -> bool:
    return one.truth[0] in one.named(count)


def _by_class(one: Judged, named: Sequence[str]) -> bool:
    return bool(named) and named[0] in one.oracle["class"]


def _singles(cases: list[Judged]) -> list[Row]:
    rows = []
    for d in LADDER:
        at = [one for one in cases if _nominal_d(one) == d]
        for count in (1, 3):
            known = [one.truth[0] in one.oracle["ranking"][:count] for one in at]
            best = _mean(known)
            beside = {}
            for name in ("bic", "unwhitened"):
                ranked = [one for one in at if "baselines" in one.oracle]
                beside[name] = _mean([o.truth[0] in o.oracle["baselines"][name][:count] for o in ranked])
            floor = best - 0.015 if best is not None and count == 1 else None
            rows.append(fraction(f"single, top-{count}, d = {d:g}", [_top(one, count) for one in at],
                                 at_least=floor, oracle=best, **beside))  # fmt: skip
        floor = {6.0: 0.95}.get(d, 0.99 if d >= 8 else None)
        best = _mean([_by_class(one, one.oracle["ranking"]) for one in at])
        hits = [_by_class(one, one.named(1)) for one in at]
        rows.append(fraction(f"single, by class, d = {d:g}", hits, at_least=floor, oracle=best))
    return rows


def _covered(one: Judged) -> bool:
    """Whether the smallest sets that together have 95 % hold the truth."""
    total = 0.0
    for effects, probability in one.sets():
        total += probability
        if effects == frozenset(one.truth):
            return True
        if total >= 0.95:
            return False
    return not one.sets() and one.said == "no_gap" and not one.truth


def _calibration_error(pairs: np.ndarray) -> float:
    """Expected calibration error over ten bins of the leading set's probability."""
    bins = np.minimum((pairs[:, 0] * 10).astype(int), 9)
    total = 0.0
    for k in range(10):
        own = pairs[bins == k]
        if len(own):
            total += len(own) * abs(own[:, 0].mean() - own[:, 1].mean())
    return float(total / len(pairs))


def _chance_calibration_error(leading: Sequence[tuple[float, bool]]) -> float | None:
    """What the same probabilities would have, were they exactly right: so few cases scatter in their bins."""
    if not leading:
        return None
    rng = np.random.Generator(np.random.Philox(8))
    p = np.array([one for one, _ in leading])
    draws = [np.column_stack([p, rng.random(len(p)) < p]) for _ in range(200)]
    return float(np.mean([_calibration_error(one) for one in draws]))


def _attributed_wrongly(one: Judged) -> bool:
    """Named an effect of the unit with confidence though it is none of the true ones, nor like them."""
    named = one.named(1)
    return one.said == "attributed" and bool(named) and named[0] not in one.oracle.get("class", one.truth)


def _abstained(cases: Iterable[Judged]) -> list[bool]:
    return [one.said == "unattributed" for one in cases]


def _abstentions(kinds: dict[str, list[Judged]]) -> list[Row]:
    foreign, withheld = kinds["out_of_catalogue"], kinds["withheld"]

    def far(cases: list[Judged]) -> list[Judged]:
        return [one for one in cases if one.label["facts"][0].get("d_outside", 0) >= 12]

    known = [one for one in kinds["single"] if one.label["d"][0] >= 7.9]
    strange = far(foreign) + far(withheld) + kinds["decoy"]
    blamed = [_attributed_wrongly(o) and not o.named(1)[0].startswith("stand.") for o in kinds["decoy_stand"]]
    rows = [
        fraction("abstains, out of catalogue, d⊥ ≥ 12", _abstained(far(foreign)), at_least=0.95),
        fraction("abstains, effect withheld, d⊥ ≥ 12", _abstained(far(withheld)), at_least=0.95),
        fraction("abstains, decoys", _abstained(kinds["decoy"]), at_least=0.95),
        fraction("attributed, all of these", [one.said == "attributed" for one in strange], at_most=0.05),
        fraction("false abstention, singles d ≥ 8", _abstained(known), at_most=0.02),
        fraction("blamed on a unit, stand effects", blamed, at_most=0.05),
    ]
    for name in sorted({one.truth[0] for one in foreign}):
        own = _abstained(one for one in far(foreign) if one.truth[0] == name)
        rows.append(fraction(f"  abstains, {name}, d⊥ ≥ 12", own))
    return rows


def _next_tests(singles: list[Judged]) -> list[Row]:
    """Information a minute of the proposed test, as a share of the best excitation's in hindsight."""
    unsure = [one for one in singles if one.said == "confusable"]
    proposed = [one for one in unsure if one.report.get("next_test")]
    shares, liked = [], []
    for one in proposed:
        kind = kind_of(str(one.report["next_test"].get("profile")))
        rates = one.oracle.get("next_tests") or {}
        best = max(rates.values(), default=0.0)
        liked.append(kind is not None)
        if kind is not None and best > 1e-6:
            shares.append(rates[kind] / best)
    return [
        statistic(
            "next test, share of the best's information", shares, lambda x: float(x.mean()), at_least=0.9
        ),
        fraction("next test proposed where confusable", [bool(o.report.get("next_test")) for o in unsure]),
        fraction("next test is like one of the four", liked),
    ]


def scored(cases: list[Judged]) -> list[Row]:
    """All rows of the table."""
    kinds: dict[str, list[Judged]] = {kind: [] for kind in KINDS_OF_CASES}
    for one in cases:
        kinds[one.label["kind"]].append(one)
    nulls, singles, pairs = kinds["null"], kinds["single"], kinds["pair"]
    rows = [
        fraction("engine failed", [one.said == "error" for one in cases], at_most=0.0),
        fraction(
            "false alarms on nulls", [one.said != "no_gap" for one in nulls], at_least=0.035, at_most=0.065
        ),
        *_singles(singles),
        fraction("seen in single rows, top-1", [_top(one, 1) for one in kinds["discrete"]], oracle=1.0),
    ]
    best = _mean([set(one.truth) == set(one.oracle["sets"][0]) for one in pairs])
    hits = [bool(one.sets()) and one.sets()[0][0] == frozenset(one.truth) for one in pairs]
    rows.append(
        fraction("pair, exact set", hits, at_least=None if best is None else best - 0.03, oracle=best)
    )
    rows += _abstentions(kinds)
    answered = [one for one in nulls + singles + pairs if one.said != "error"]
    rows.append(fraction("95 % set covers", [_covered(one) for one in answered], at_least=0.93, at_most=0.98))
    leading = [(o.sets()[0][1], o.sets()[0][0] == frozenset(o.truth)) for o in answered if o.sets()]
    rows.append(
        statistic(
            "expected calibration error",
            leading,
            _calibration_error,
            at_most=0.03,
            oracle=_chance_calibration_error(leading),
        )
    )
    rows += _figures(singles)
    real = kinds["semi_real"]
    rows.append(fraction("semi-real, false alarms", [one.said != "no_gap" for one in real if not one.truth]))
    named = [one for one in real if one.truth]
    rows.append(fraction("semi-real, top-1", [_top(one, 1) for one in named],
                         oracle=_mean([o.truth[0] == o.oracle["ranking"][0] for o in named])))  # fmt: skip
    return rows + _times(cases)


def _figures(singles: list[Judged]) -> list[Row]:
    """Parameters, shrinkage, next test."""
    errors = [error for one in singles if _top(one, 1) for error in normalised_errors(one)]
    closed = []
    for one in singles:
        if one.label["d"][0] >= 7.9 and _top(one, 1) and "fraction_closed" in one.oracle:
            reached = (one.report.get("shrinkage") or {}).get("fraction_closed")
            closed.append((float(reached or 0), one.oracle["fraction_closed"]))
    return [
        statistic("parameters, RMSE / Cramér–Rao", errors, _root_mean_square, at_most=1.2),
        statistic("shrinkage of the oracle's, d ≥ 8", closed, _ratio_of_sums, at_least=0.97, oracle=1.0),
        *_next_tests(singles),
    ]


def _root_mean_square(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _ratio_of_sums(pairs: np.ndarray) -> float:
    return float(pairs[:, 0].sum() / pairs[:, 1].sum())


def _times(cases: list[Judged]) -> list[Row]:
    seconds = [one.verdict["cpu_s"] for one in cases]
    each = [one.verdict["cpu_s"] / one.verdict["rows"] for one in cases if one.verdict.get("rows")]
    return [
        statistic("CPU seconds a case, mean", seconds, lambda x: float(x.mean())),
        statistic("1 h at 200 Hz, s on two cores, by rows", each,
                  lambda x: float(np.median(x)) * RECORDING_OF_THE_GOAL_ROWS / CORES, at_most=60.0),
    ]  # fmt: skip


def as_documents(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """For results.json."""
    return [asdict(row) for row in rows]
