"""A twin whose core went to other programs says what helps; no other does."""

from fiberloom.twin.server.told import paced_text

REPORT = {
    "time_s": 1.0, "ticks": 2000, "resting": 0, "share_kept": 0.9, "p50_ms": 0.1, "p99_ms": 1.0, "worst_ms": 4.0,
    "woken_ms": (0.1, 1.0, 4.0), "computing_ms": (0.1, 0.2, 0.3), "clients": 0, "frames_in": 0, "frames_out": 0,
    "given_up_s": 0.0, "overflowed": 0, "unread": 0, "lost": 0, "late": 0, "refused_clients": 0, "happened": [],
}  # fmt: skip


def told(first, **causes):
    late = {"late_by_cause": causes, "first_by_cause": causes, "first": first}
    return paced_text(REPORT | late)


def test_a_clock_of_ordinary_priority_is_told_how_to_go_first():
    assert "--first" in told(False, woken=150, taken=50)


def test_nothing_is_advised_where_it_would_not_help():
    assert "--first" not in told(True, woken=150, taken=50)
    assert "--first" not in told(False, computed=200, woken=1)
