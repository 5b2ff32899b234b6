"""An IOC of a small array on the twin, in a process of its own: `ioc.py FOLDER PREFIX PORT`.

It does as a line on its input says: `slow`, `fast` (the twin's clock), `run` (for a second), `lock`, `free`
(the state of the array). It answers with where fibres are, in mm, and ends with its input.
"""

import asyncio
import json
import sys
from pathlib import Path

from observed import observed

from fiberloom.observatory.epics import EpicsIoc
from fiberloom.observatory.network import Endpoint


async def main(folder, prefix, port):
    array, held = observed(folder)
    ioc = asyncio.create_task(EpicsIoc(array, prefix, Endpoint("127.0.0.1", port)).run())
    await asyncio.sleep(0.0)
    print("ready", flush=True)
    while line := (await asyncio.to_thread(sys.stdin.readline)).strip():
        if line in ("slow", "fast"):
            (held.slow.set if line == "slow" else held.slow.clear)()
        elif line == "lock":
            array.book.note_stopped("collision of positioners 3, 4", "locked")
        elif line == "free":
            array.book.note_stopped("", "idle")
        elif line == "run":
            held.twin.run(1.0)
        print(json.dumps(held.twin.fibre_xy("metrology").tolist()), flush=True)
    ioc.cancel()
    array.close()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])))
