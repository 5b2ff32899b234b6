"""Reports of served twins as text."""

from __future__ import annotations

from typing import Any

WORTH_A_LINE = 1e-3
"""Share of ticks not kept for want of a core, from which on a way out is told."""
_LOSSES = {
    "given_up_s": "s of clock given up",
    "overflowed": "frames over the queue",
    "unread": "frames unread by the client",
    "lost": "replies lost on purpose",
    "late": "replies late on purpose",
    "refused_clients": "clients turned away",
}


def counts_text(report: dict[str, Any]) -> str:
    """The numbers of a `report` in one line."""
    return ", ".join(f"{name} {value:.10g}" for name, value in report.items() if not isinstance(value, list))


def _causes(report: dict[str, Any]) -> list[str]:
    """Why ticks were not kept; nothing where all were."""
    found = {name: n for name, n in report["late_by_cause"].items() if n}
    first = report["first_by_cause"]
    if not found:
        return []
    woken, computing = ("{:.2f} ms (half), {:.2f} ms (99 %), {:.2f} ms (worst)".format(*report[name])
                        for name in ("woken_ms", "computing_ms"))  # fmt: skip
    late = ", ".join(f"{name} {n} ({first[name]} by themselves)" for name, n in found.items())
    return [f"not kept: {late}; woken late by {woken}; a tick computed in {computing}"]


def _advice(report: dict[str, Any]) -> list[str]:
    """What helps a clock of ordinary priority whose core went to other programs."""
    others = sum(report["late_by_cause"].get(cause, 0) for cause in ("woken", "taken"))
    if report["first"] or others < WORTH_A_LINE * report["ticks"]:
        return []
    return ["other programs had its core: with --first it runs before them (needs root or CAP_SYS_NICE)"]


def paced_text(report: dict[str, Any]) -> str:
    """The `report` of a twin that keeps the ticks of a clock, as a few lines."""
    lines = [
        f"{report['time_s']:.1f} s of twin time: "
        f"{report['ticks']} ticks computed, {report['resting']} at rest",
        f"kept {100 * report['share_kept']:.2f} % of the ticks; late by {report['p50_ms']:.2f} ms (half), "
        f"{report['p99_ms']:.2f} ms (99 %), {report['worst_ms']:.2f} ms (worst)",
        *_causes(report),
        *_advice(report),
        f"{report['clients']} clients, {report['frames_in']} frames in, {report['frames_out']} out",
    ]
    lost = [f"{report[key]:.4g} {what}" for key, what in _LOSSES.items() if report[key]]
    return "\n".join([*lines, *([", ".join(lost)] if lost else []), *report["happened"]])
