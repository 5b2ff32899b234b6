"""A twin whose core went to other programs says what helps; no other does."""

from fiberloom.twin.server.told import paced_text

ZEROS = [
    "resting",
    "clients",
    "frames_in",
    "frames_out",
    "given_up_s",
    "overflowed",
    "unread",
    "lost",
    "late",
    "refused_clients",
    "p50_ms",
    "p99_ms",
    "worst_ms",
]
REPORT = dict.fromkeys(ZEROS, 0) | {
    "time_s": 1.0,
    "ticks": 2000,
    "share_kept": 0.9,
    "woken_ms": (0.1, 1.0, 4.0),
    "computing_ms": (0.1, 0.2, 0.3),
    "happened": [],
}


def told(first, **causes):
    late = {"late_by_cause": causes, "first_by_cause": causes, "first": first}
    return paced_text(REPORT | late)


def test_a_clock_of_ordinary_priority_is_told_how_to_go_first():
    assert "--first" in told(False, woken=150, taken=50)


def test_nothing_is_advised_where_it_would_not_help():
    assert "--first" not in told(True, woken=150, taken=50)
    assert "--first" not in told(False, computed=200, woken=1)
