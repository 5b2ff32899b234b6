"""Serve an array to the control system of an observatory, by OPC UA and by EPICS. Ctrl-C stops what moves.

On the twin inside of this process:   python examples/observatory.py --opcua 127.0.0.1:4840 --epics FPS
On an array:                          python examples/observatory.py --opcua 127.0.0.1:4840 \
                                          --bus cannet://10.1.10.31 --camera alpaca://10.1.10.40:11111/0
It prints the addresses that clients need. Target lists are those of the folder that --targets names.
"""

import argparse
import asyncio
import contextlib
from pathlib import Path

import fiberloom as fl
from fiberloom.blocking import finish
from fiberloom.connect import array_address
from fiberloom.observatory.array import SessionArray
from fiberloom.observatory.epics import DEFAULT_PORT as CA_PORT
from fiberloom.observatory.epics import EpicsIoc
from fiberloom.observatory.network import Endpoint
from fiberloom.observatory.opcua import DEFAULT_PORT, opcua_server
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bus", default="twin:")
    parser.add_argument("--camera", default="noise")
    parser.add_argument("--instrument", default="sdssv")
    parser.add_argument("--positioners", type=int, default=37)
    parser.add_argument("--layout", type=Path)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--targets", type=Path, default=Path("examples"))
    parser.add_argument("--out", type=Path, default=Path("runs/observatory"))
    parser.add_argument("--opcua", metavar="HOST[:PORT]")
    parser.add_argument("--epics", metavar="PREFIX")
    parser.add_argument("--epics-listen", metavar="HOST[:PORT]", default="127.0.0.1")
    parser.add_argument("--trusted-network", action="store_true")
    return parser.parse_args()


def array_of(args: argparse.Namespace) -> SessionArray:
    plane = fl.FocalPlane.read(args.layout) if args.layout else None
    plane = plane or fl.FocalPlane.of(args.instrument, n=args.positioners)
    field = fl.Field.open(plane, args.bus, args.camera, args.calibration)
    args.out.mkdir(parents=True, exist_ok=True)
    book = ArrayBook(Store.open(args.out / "arrays.sqlite"), array_address(args.bus))
    return SessionArray(field, book, args.bus, args.targets, args.out)


async def serve(args: argparse.Namespace) -> None:
    array = array_of(args)
    try:
        async with contextlib.AsyncExitStack() as stack:
            if args.opcua:
                at = Endpoint.parse(args.opcua, DEFAULT_PORT, args.trusted_network)
                print(await stack.enter_async_context(opcua_server(array, at)), flush=True)
            if args.epics:
                at = Endpoint.parse(args.epics_listen, CA_PORT, args.trusted_network)
                ioc = asyncio.create_task(EpicsIoc(array, args.epics, at).run())
                stack.callback(ioc.cancel)
                print(f"EPICS_CA_ADDR_LIST={at}: {args.epics}:STATE, ...", flush=True)
            await asyncio.Event().wait()
    finally:
        await asyncio.to_thread(array.close)


if __name__ == "__main__":
    try:
        finish(serve(parsed()))
    except (fl.InputError, KeyboardInterrupt) as error:
        raise SystemExit(str(error) or 130) from None
