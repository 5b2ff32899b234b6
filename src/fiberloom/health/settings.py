"""When a healthy positioner is called ill: every threshold of `fiberloom.health.monitor`, with its origin.

[D] derived from a cited number, [A] assumed. All of them are checked together by the trials of
docs/operation/health.md: how soon an ailment is found, and how rarely a healthy positioner is called ill.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Odds = tuple[float, float]
"""Probability of one event in one move: of a healthy positioner, of a broken one."""


@dataclass(frozen=True)
class Clips:
    """Largest step of a chart, so that one wild measurement decides nothing. Log likelihoods.

    [A] The alarm of 20 then takes at least two, three or five measurements.
    """

    scale: float = 7.0
    tooth: float = 12.0
    """Few moves end at one place: two must do."""
    friction: float = 4.0
    scatter: float = 4.0


@dataclass(frozen=True)
class HealthSettings:
    """Thresholds; scores are log likelihoods."""

    # verdicts
    alarm: float = 20.0
    """[D] Once in e^20 = 5e8 steps of a healthy chart: years of a whole array."""
    suspect_share: float = 0.5
    """[A] Share of the alarm from which a positioner is named at all."""
    clips: Clips = field(default_factory=Clips)

    # what an image tells
    least_sine: float = 0.25
    """[A] Of beta: nearer than 14 deg to a straight or folded arm a fibre does not tell the angles."""
    linear_deg: float = 0.3
    """[A] Largest miss that the Jacobian is used for; beyond it both angles are solved anew."""
    far_deg: float = 2.0
    """[A] A way longer than this ends on another part of the map: its error is a new one."""
    map_tail: float = 1.6
    """[A] Misses of maps are not Gaussian: their standard deviation is taken so many times as large."""
    camera_floor_mm2: float = 1e-12
    """[A] A perfect camera would divide by nothing: 1 nm."""

    # dark
    dark: Odds = (1e-4, 0.99)
    """[A] A healthy fibre is lost in one image of ten thousand."""

    # not moving
    tell_way_deg: float = 0.3
    """[A] Shorter ways do not tell a non-move from a miss."""
    tell_way_mm: float = 0.3
    """[A] The same in the focal plane."""
    tell_turn_deg: float = 300.0
    """[A] Longer ways of alpha end near where they began: nearly a whole turn looks as none."""
    tell_way_sd: float = 12.0
    """[A] Standard deviations that a way must have to tell."""
    still_share: float = 0.03
    """[A] Of the way: a positioner that goes less has not moved. A gear that slips goes more."""
    still_sd: float = 4.0
    """[A] Or less than so many standard deviations of the miss."""
    still: Odds = (1e-6, 0.15)
    """[A] Of a move that was reported and not made; a bad driver fails one move of seven."""
    stuck_again: int = 2
    """[A] Moves in a row, at least, that were not made by one that is stuck,"""
    stuck_sure: float = 3.0
    """[A] and those with which the evidence counts in full."""
    blocked: Odds = (1e-4, 0.5)
    """[A] A way that ends as a collision may be a neighbour's fault once; hardly four times."""

    # wrong share of the way
    scale_step: float = 0.01
    """[A] A share of the way that is worth knowing."""
    scale_miss_deg: float = 90.0
    """[A] A miss of more than a quarter turn is no share of the way: alpha may have gone round."""

    # slips and places
    jump_mm: float = 0.3
    """[A] Smaller jumps are left to the fit of the last moves."""
    jump_sd: float = 8.0
    """[A] Standard deviations of a sudden miss."""
    stays_sd: float = 5.0
    """[A] It is a slip if the next miss is the same within so many."""
    slip_alarms: float = 1.1
    """[A] What such a slip adds, in alarms: one is enough."""
    tooth_deg: float = 10.0
    """[D] Pitch of the last stage: 36 pairings a turn (Fig. 10)."""
    tooth_sd: float = 4.0
    """[A] Standard deviations of the miss at one place that are worth knowing."""

    # offsets and arms
    fit_deg: float = 1.0
    """[A] Larger misses are slips: they are left out of the fit."""
    memory: float = 0.9
    """[A] Of the fit of offsets and arm length, from field to field: about ten fields."""
    arm_um: float = 15.0
    """[D] Length that an arm does not gain by wear (Fig. 21: 1 um)."""

    # scatter
    scatter_ratio: float = 9.0
    """[A] Of the variance that is worth knowing: three times the standard deviation."""
    wobble_memory: float = 0.1
    """[A] Weight of the newest move in the mean square along and across the arm."""
    revisit_deg: float = 0.1
    """[A] Small moves nearer than this to a place of an earlier run tell of the place, not of scatter."""
    revisits: int = 64
    """[A] Runs whose places are remembered."""
    lengthwise: float = 4.0
    """[A] Ratio of these from which scatter is the arm's length, not its angle."""

    # torque
    effort_step: float = 0.15
    """[A] Rise of the effort that is worth knowing."""
    effort_sd: float = 0.05
    """[A] From move to move, once what all have in common is taken off."""
    settle: int = 20
    """[A] Moves in which a positioner's own torque is learnt."""
