"""The plant of plant.c in numba, one compiled loop over structures of arrays. Prints ns per axis and tick.

python benchmarks/peers/numba_plant.py AXES TICKS float32|float64
"""

import sys
import time

try:
    import numba
except ImportError:
    sys.exit("numba is not installed")
import numpy as np

BLOCK, STEPS = 64, 10
FIELDS = 20


@numba.njit(fastmath=True, error_model="numpy")
def step(b):
    """One step of all axes of a block (FIELDS, BLOCK)."""
    real = b.dtype.type
    for i in range(b.shape[1]):
        # all is read before anything is chosen: then the compiler finds vectors
        theta, p, last = b[0, i], b[1, i], b[2, i]
        drag_free, drag_push, slow_free, slow_push = b[12, i], b[13, i], b[14, i], b[15, i]
        per_p_free, per_p_push, resist_up, resist_down = b[16, i], b[17, i], b[10, i], b[11, i]
        turns = np.floor(theta * real(0.6366197723675814) + real(0.5))
        r = theta - turns * real(1.5707963267948966)
        z = r * r
        s0 = r + r * z * (real(-0.16666654611) + z * (real(8.3321608736e-3) - z * real(1.9515295891e-4)))
        c0 = real(1) - real(0.5) * z + z * z * (real(4.166664568e-2) - z * real(1.38873163e-3))
        quarter = np.int32(turns)
        odd = (quarter & 1) != 0
        s1, c1 = (c0 if odd else s0), (s0 if odd else c0)
        s = -s1 if (quarter & 2) != 0 else s1
        c = -c1 if ((quarter + 1) & 2) != 0 else c1
        s2, c2 = real(2) * s * c, real(1) - real(2) * s * s
        torque = b[3, i] * s + b[4, i] * c - b[5, i] * s2 - b[6, i] * c2
        below = (theta - b[7, i]) * b[8, i]
        gear = min(max(last, below), theta)
        up, down = below >= gear, theta <= gear
        force = p + torque
        pushing = (up & (force > real(0))) | (down & (force < real(0)))
        slowed = force - (drag_push if pushing else drag_free) * p
        rise = slowed - b[9, i] - (resist_up if up else real(0))
        fall = slowed + b[9, i] + (resist_down if down else real(0))
        p = (max(rise, real(0)) + min(fall, real(0))) * (slow_push if pushing else slow_free)
        b[1, i], b[2, i] = p, gear
        b[0, i] = theta + p * (per_p_push if pushing else per_p_free)


@numba.njit(fastmath=True)
def run(blocks, ticks):
    """All steps of so many ticks."""
    for _ in range(ticks):
        for k in range(blocks.shape[0]):
            for _ in range(STEPS):
                step(blocks[k])


def set_up(axes, real):
    """Blocks as plant.c has them."""
    h, inertia = 5e-5, 3.4e-9
    column = [0, 209.0 * inertia, 0, h * 1e-4, h * 1e-4, h * 1e-5, h * 1e-6, 2.0, 1.0, h * 1e-6]
    column += [h * 1.9e-5, h * 1.9e-5, 1e-3, 1e-3, 0.999, 0.999, h / inertia, h / (inertia + 1e-10), 0, 0]
    blocks = np.empty(((axes + BLOCK - 1) // BLOCK, FIELDS, BLOCK), real)
    blocks[:] = np.array(column, real)[:, None]
    blocks[:, 0] = blocks[:, 2] = 0.01 * np.arange(BLOCK)
    return blocks


def main():
    axes, ticks, real = int(sys.argv[1]), int(sys.argv[2]), np.dtype(sys.argv[3])
    blocks = set_up(axes, real)
    run(blocks, 1)  # compiled here
    begin_s = time.process_time()
    run(blocks, ticks)
    print(f"{1e9 * (time.process_time() - begin_s) / (blocks.shape[0] * BLOCK * ticks):.3f}")


if __name__ == "__main__":
    main()
