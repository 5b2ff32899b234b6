"""The real jaeger moves ten positioners of the twin, and reads where they are. It prints "within 0.01 deg".

In one terminal:   fiberloom twin --positioners 10 --jaeger-config runs/jaeger/jaeger.yml
In another:        make jaeger
                   export OBSERVATORY=APO JAEGER_APO_CONFIG_PATH=$PWD/runs/jaeger/jaeger.yml
                   .venv-jaeger/bin/python examples/jaeger_on_the_twin.py
"""

import asyncio

import numpy as np
from jaeger import FPS


async def main() -> None:
    fps = await FPS.create(ieb=False)
    goals = {i: (20.0 + k, 165.0) for k, i in enumerate(sorted(fps))}
    await fps.goto(goals, go_cowboy=True, save_snapshot=False)
    off_deg = max(np.abs(np.subtract(fps[i].position, goal)).max() for i, goal in goals.items())
    print(f"{len(fps)} positioners {'within 0.01 deg' if off_deg < 0.01 else f'off by {off_deg:.3f} deg'}")
    await fps.shutdown()


if __name__ == "__main__":
    asyncio.run(main())
