"""The table, the summary and the picture of a campaign, from its runs' lines alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from missions.look.report.tables import counts_text
from missions.proofs.campaign.levels import LEVELS
from missions.proofs.campaign.results import OBSERVED_PERCENT, RunLine

SHOWN = 20  # failures printed
BROKEN = {
    "clock": "a clock was set",
    "disk": "a disk lost a record",
    "stall": "a program stood still",
}


def summarize(
    program: str,
    seed: int,
    lines: Sequence[RunLine],
    command: Callable[[RunLine], str],
) -> dict[str, Any]:
    """``summary.json``. ``command`` makes the line that replays a run."""
    from missions.proofs.campaign.bounds import BOUNDS  # noqa: PLC0415

    violations: Counter[str] = Counter(
        what.partition(" ")[0] for line in lines for what in line.violations
    )
    beyond: Counter[str] = Counter(what.partition(" ")[0] for line in lines for what in line.beyond)
    levels = [level for level in LEVELS if any(line.level == level for line in lines)]
    return {
        "program": program,
        "seed": seed,
        "runs": len(lines),
        "violations": sum(violations.values()),
        "violations_of": dict(sorted(violations.items())),
        "beyond_assumptions": dict(sorted(beyond.items())),
        "assumptions_broken": dict(
            sorted(Counter(name for line in lines for name in line.broken).items())
        ),
        "levels": {
            level: _level([line for line in lines if line.level == level]) for level in levels
        },
        "times": {
            name: {**_times(lines, name), "bound_s": BOUNDS.get((program, name))}
            for name in _names(lines)
        },
        "simulated_h": round(
            sum(line.figures.get("simulated_s", 0.0) for line in lines) / 3600.0, 2
        ),
        "failures": [
            {
                "number": line.number,
                "level": line.level,
                "violations": list(line.violations),
                "replay": command(line),
            }
            for line in lines
            if line.violations
        ],
    }


def _level(lines: Sequence[RunLine]) -> dict[str, Any]:
    observed = [share for line in lines for share in line.observed_percent.values()]
    return {
        "runs": len(lines),
        "violations": sum(len(line.violations) for line in lines),
        "outcomes": dict(Counter(line.outcome for line in lines).most_common()),
        "times": {name: _times(lines, name) for name in _names(lines)},
        "targets": {
            "number": len(observed),
            "observed_well": sum(share >= OBSERVED_PERCENT for share in observed),
            "least_percent": min(observed, default=None),
            "mean_percent": round(float(np.mean(observed)), 3) if observed else None,
        },
    }


def _names(lines: Sequence[RunLine]) -> list[str]:
    return sorted({name for line in lines for name in line.figures if name != "simulated_s"})


def _times(lines: Sequence[RunLine], name: str) -> dict[str, float | int]:
    values = np.array([line.figures[name] for line in lines if name in line.figures])
    if not len(values):
        return {"runs": 0}
    return {
        "runs": len(values),
        "median_s": round(float(np.median(values)), 4),
        "p90_s": round(float(np.percentile(values, 90)), 4),
        "worst_s": round(float(values.max()), 4),
    }


_MEANING = {
    "decided_s": "from the offer to each side's decision (L1)",
    "commit_s": "from COMMIT to the sender's decision (L1)",
    "unobserved_s": "nobody looked at a target, in all",
    "gap_s": "longest time with nobody responsible (L2)",
}


def table(summary: dict[str, Any]) -> str:
    """Return a campaign's table for a person."""
    levels: dict[str, Any] = summary["levels"]
    outcomes = Counter[str]()
    for level in levels.values():
        outcomes.update(level["outcomes"])
    lines = ["", f"{'outcome':<28}" + "".join(f"{level:>18}" for level in levels)]
    for outcome, _ in outcomes.most_common():
        cells = (
            _share(level["outcomes"].get(outcome, 0), level["runs"]) for level in levels.values()
        )
        lines.append(f"{outcome:<28}" + "".join(f"{cell:>18}" for cell in cells))
    lines.append(
        f"{'runs':<28}" + "".join(f"{level['runs']:>10,}{'':>8}" for level in levels.values())
    )
    lines += ["", f"{'time':<46}{'level':<9}{'median':>9}{'p90':>9}{'worst':>9}{'bound':>9}  s"]
    for name, times in summary["times"].items():
        bound = times["bound_s"]
        for level, of in levels.items():
            own = of["times"].get(name)
            if own:
                limit = "" if bound is None else f"{bound:9.3f}"
                lines.append(
                    f"{_MEANING.get(name, name):<46}{level:<9}{own['median_s']:9.3f}{own['p90_s']:9.3f}"
                    f"{own['worst_s']:9.3f}{limit:>9}"
                )
    for level, of in levels.items():
        if (own := of["targets"])["number"]:
            lines.append(
                f"{'targets observed for ' + f'{OBSERVED_PERCENT:g} % and more of the time':<46}{level:<9}"
                f"{own['observed_well']} of {own['number']}, mean {own['mean_percent']:.2f} %, "
                f"least {own['least_percent']:.2f} %"
            )
    found = counts_text(summary["violations_of"])
    lines += [
        "",
        f"{summary['runs']:,} runs, {summary['simulated_h']:,} h simulated; violations: {found}",
    ]
    if summary["assumptions_broken"]:
        broken = ", ".join(
            f"{BROKEN[name]} in {count} runs"
            for name, count in summary["assumptions_broken"].items()
        )
        lines.append(f"assumptions broken: {broken}")
    if summary["beyond_assumptions"]:
        beyond = counts_text(summary["beyond_assumptions"])
        lines.append(f"after one of these, which the promises do not bear: {beyond}")
    for failure in summary["failures"][:SHOWN]:
        lines += [f"  {failure['violations'][0]}", f"    {failure['replay']}"]
    if len(summary["failures"]) > SHOWN:
        lines.append(f"  ... and {len(summary['failures']) - SHOWN} more in summary.json")
    return "\n".join(lines) + "\n"


def _share(count: int, runs: int) -> str:
    return f"{count:,} {100.0 * count / runs:5.1f} %" if count else "-"


def draw_outcomes(summary: dict[str, Any], path: Path) -> None:
    """Outcomes by level, as shares."""
    levels: dict[str, Any] = summary["levels"]
    names = Counter[str]()
    for level in levels.values():
        names.update(level["outcomes"])
    figure = Figure(figsize=(9.0, 1.6 + 0.55 * len(levels)), layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(levels))
    palette = _colors(len(names))
    for color, (name, _) in zip(palette, names.most_common(), strict=True):
        share = np.array(
            [100.0 * level["outcomes"].get(name, 0) / level["runs"] for level in levels.values()]
        )
        axes.barh(range(len(levels)), share, left=left, label=name, color=color)
        left += share
    axes.set_yticks(
        range(len(levels)), [f"{name}\n{level['runs']:,} runs" for name, level in levels.items()]
    )
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("share of the runs, %")
    axes.set_title(
        f"{summary['program']}: {summary['runs']:,} runs, {summary['violations']} violations",
        fontsize=10,
    )
    figure.legend(loc="outside right center", fontsize=7, frameon=False)
    figure.savefig(path, dpi=130)


def _colors(count: int) -> list[Any]:
    import matplotlib as mpl  # noqa: PLC0415

    return [mpl.colormaps["tab20"](index % 20) for index in range(count)]
