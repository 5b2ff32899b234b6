"""MEGARA's blind steppers: steps and angles, programmes of moves, and our own frames that carry them."""

from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, decode_goal, decode_state, goal_frames
from fiberloom.drive.megara.programme import MoveProgramme, read_programme

__all__ = [
    "MegaraCommand",
    "MegaraFrame",
    "MoveProgramme",
    "decode_goal",
    "decode_state",
    "goal_frames",
    "read_programme",
]
