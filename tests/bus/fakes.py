"""A bus of scripted positioners with a clock of its own."""

import struct

from fiberloom.bus import Command, Frame, Link, Status, TransportLost
from fiberloom.bus.identifier import decode, encode

READY = Status.SYSTEM_INITIALIZED | Status.DATUMS_INITIALIZED | Status.DISPLACEMENT_COMPLETED


class FakePositioner:
    """Knows just enough of the protocol for the client's tests; moves take `move_s`."""

    def __init__(self, number, move_s=1.0):
        self.number = number
        self.move_s = move_s
        self.position = [0, 0]
        self.goal = [0, 0]
        self.busy_until_s = 0.0
        self.flags = Status(0)
        self.points = []
        self.counts = None
        """Of the trajectory that is being received."""
        self.ends = None
        """Of the one that is held."""
        self.loaded = False
        self.requests = []
        self.refuse = {}  # command -> response code
        self.lies = False  # claims the goal without having moved

    def status(self, time_s):
        busy = time_s < self.busy_until_s
        if self.loaded:
            held = Status.TRAJECTORY_ALPHA_RECEIVED | Status.TRAJECTORY_BETA_RECEIVED
        else:
            held = Status(0) if self.counts is None else Status.RECEIVING_TRAJECTORY
        return (READY ^ Status.DISPLACEMENT_COMPLETED if busy else READY) | self.flags | held

    def answer(self, identifier, data, time_s):
        """Response code and payload of the reply."""
        self.requests.append((identifier.command, data))
        if code := self.refuse.get(identifier.command, 0):
            return code, b""
        handler = getattr(self, f"on_{identifier.command}", lambda data, time_s: (0, b""))
        return handler(data, time_s)

    def on_1(self, data, time_s):
        return 0, struct.pack("<I", self.number)

    def on_2(self, data, time_s):
        return 0, bytes([21, 1, 4])

    def on_3(self, data, time_s):
        return 0, struct.pack("<Q", self.status(time_s))

    def on_10(self, data, time_s):
        self.counts, self.points, self.loaded = struct.unpack("<II", data), [], False
        return 0, b""

    def on_11(self, data, time_s):
        self.points.append(struct.unpack("<ii", data))
        return 0, b""

    def on_12(self, data, time_s):
        self.loaded = self.counts is not None and len(self.points) == sum(self.counts)
        self.ends, self.counts = self.counts, None
        return (0 if self.loaded else 2), b""

    def on_13(self, data, time_s):
        if self.lies:
            self.goal = list(self.position)
        self.busy_until_s, self.loaded, self.counts = min(self.busy_until_s, time_s), False, None
        return 0, b""

    def on_14(self, data, time_s):
        if self.loaded:
            n_alpha = self.ends[0]
            self.move([self.points[n_alpha - 1][0], self.points[-1][0]], time_s)
            self.busy_until_s = time_s + max(t for _, t in self.points) * 0.5e-3
        self.loaded = False
        return 0, b""

    def on_15(self, data, time_s):
        self.flags = Status(0)
        return self.on_13(data, time_s)

    def on_30(self, data, time_s):
        if time_s < self.busy_until_s:
            return 3, b""
        self.move(list(struct.unpack("<ii", data)), time_s)
        ticks = int(self.move_s / 0.5e-3)
        return 0, struct.pack("<ii", ticks, ticks)

    def on_31(self, data, time_s):
        steps = struct.unpack("<ii", data)
        goal = [p + d for p, d in zip(self.goal, steps, strict=True)]
        return self.on_30(struct.pack("<ii", *goal), time_s)

    def on_32(self, data, time_s):
        return 0, struct.pack("<ii", *self.goal)

    def on_33(self, data, time_s):
        self.goal = self.position = list(struct.unpack("<ii", data))
        return 0, b""

    def move(self, goal, time_s):
        self.goal = goal
        self.busy_until_s = time_s + self.move_s
        if not self.lies:
            self.position = list(goal)


class FakeBus:
    """A Transport with virtual time. Frames may be lost, doubled, delayed or falsified by hooks.

    `lose(frame) -> bool` for requests and replies; `change(reply) -> list of replies`.
    """

    def __init__(self, numbers=(), latency_s=0.5e-3):
        self.positioners = {n: FakePositioner(n) for n in numbers}
        self.latency_s = latency_s
        self.now_s = 0.0
        self.queue = []  # (due time, frame)
        self.sent = []
        self.lose_request = lambda identifier: False
        self.change = lambda identifier, frame: [(0.0, frame)]
        self.dead = False
        self.closed = False

    @property
    def time_s(self):
        return self.now_s

    async def send(self, frames):
        for frame in frames:
            if self.dead:
                raise TransportLost("connection closed by the other side")
            self.sent.append((frame[0], frame[1]))
            identifier = decode(frame[0])
            for positioner in self.addressed(identifier):
                if not self.lose_request(identifier._replace(positioner=positioner.number)):
                    self.reply(positioner, identifier, frame[1])

    def addressed(self, identifier):
        if identifier.positioner == 0:
            return list(self.positioners.values())
        found = self.positioners.get(identifier.positioner)
        return [found] if found else []

    def reply(self, positioner, identifier, data):
        code, payload = positioner.answer(identifier, data, self.now_s)
        number = encode(positioner.number, identifier.command, identifier.uid, code)
        for delay_s, frame in self.change(decode(number), Frame(number, payload)):
            self.later(self.latency_s + delay_s, frame)

    def later(self, delay_s, frame):
        self.queue.append((self.now_s + delay_s, frame))

    def collide(self, number, delay_s):
        """The positioner reports a collision of its own accord."""
        self.positioners[number].flags = Status.COLLISION_ALPHA
        self.later(delay_s, Frame(encode(number, Command.COLLISION_DETECTED), b""))

    async def receive(self, timeout_s):
        if self.dead:
            raise TransportLost("connection closed by the other side")
        end_s = self.now_s + timeout_s
        due_s = min((due for due, _ in self.queue), default=end_s)
        self.now_s = max(self.now_s, min(due_s, end_s))
        ready = [frame for due, frame in self.queue if due <= self.now_s]
        self.queue = [(due, frame) for due, frame in self.queue if due > self.now_s]
        return [frame._replace(time_s=self.now_s) for frame in ready]

    async def close(self):
        self.closed = True


class LinkedBus(FakeBus):
    """A FakeBus over two links: odd numbers on "left", even ones on "right"."""

    def __init__(self, numbers=(), latency_s=0.5e-3):
        super().__init__(numbers, latency_s)
        self.links = [Link("left"), Link("right")]
        self.events = []  # (time, what to do)

    def link_of(self, positioner):
        return self.links[0 if positioner % 2 else 1]

    def cut(self, link, at_s, back_s=None):
        self.events.append((at_s, lambda: self.links[link].goes_down("cut", self.now_s)))
        if back_s is not None:
            self.events.append((back_s, lambda: self.links[link].comes_up(self.now_s)))

    def addressed(self, identifier):
        return [p for p in super().addressed(identifier) if self.link_of(p.number).up]

    async def receive(self, timeout_s):
        due_s = min((at_s for at_s, _ in self.events), default=self.now_s + timeout_s)
        frames = await super().receive(max(min(timeout_s, due_s - self.now_s), 0.0))
        for event in [event for event in self.events if event[0] <= self.now_s]:
            self.events.remove(event)
            event[1]()
        return [frame for frame in frames if self.link_of(frame.id >> 18).up]
