"""Every call of a paced twin from several threads at once: nothing is lost, nothing comes twice.

`make races` runs it where the thread sanitizer watches each access to memory.
"""

import os
import struct
import threading
import time
from collections import Counter

import numpy as np
from wire import GOTO, STATUS, counts

from fiberloom._core import metrology
from fiberloom.bus.identifier import decode, encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.real_time import RealTimeTwin

PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=7)
IDS = [int(i) for i in PLANE.positioner_id]
ROUNDS, UIDS = int(os.environ.get("FIBERLOOM_THREAD_ROUNDS", 40)), range(1, 9)


def post_status(real, uid, sent):
    """One question to each positioner, round after round, under an identifier of its own."""
    for _ in range(ROUNDS):
        real.post([(encode(number, STATUS, uid), b"", 0, 0.0) for number in IDS])
        sent[uid] += len(IDS)
        time.sleep(0.002)


def collect(real, answers, done):
    while not done.is_set():
        answers += real.take()
        time.sleep(0.001)
    answers += real.take()


def look(real, done):
    while not done.is_set():
        assert real.lateness().kept >= 0
        assert real.time_s >= 0.0
        with real.held() as held:
            assert np.isfinite(held.truth()).all()


def answered(answers):
    """Replies by uid, of the questions alone."""
    heard = [decode(reply.id) for reply in answers]
    return Counter(h.uid for h in heard if h.command == STATUS)


def test_several_threads_use_one_paced_twin():
    twin = Twin(PLANE, draw_units(PLANE, seed=2), seed=1, threads=2)
    real, done, answers, sent = RealTimeTwin(twin, speed=5.0), threading.Event(), [], Counter()
    real.post([(encode(n, GOTO, 60), struct.pack("<ii", counts(14.0), counts(166.0)), 0, 0.0) for n in IDS])
    askers = [threading.Thread(target=post_status, args=(real, uid, sent)) for uid in UIDS]
    others = [threading.Thread(target=collect, args=(real, answers, done))]
    others += [threading.Thread(target=look, args=(real, done)) for _ in range(2)]
    for thread in (*askers, *others):
        thread.start()
    for thread in askers:
        thread.join()
    waited = time.monotonic() + 60.0
    while sum(answered(answers).values()) < sum(sent.values()) and time.monotonic() < waited:
        time.sleep(0.02)
    done.set()
    for thread in others:
        thread.join()
    real.close()
    assert answered(answers) == sent == {uid: ROUNDS * len(IDS) for uid in UIDS}


def test_bands_of_an_image_do_not_touch_each_other():
    light_e = np.random.default_rng(1).uniform(0.0, 2e4, (97, 64)).astype(np.float32)
    sky, detector = (20.0, 0.01, 0.02), (1.5, 3.0, 100.0, 6e4)
    one, four = (metrology.expose(light_e, sky, detector, seed=5, threads=n) for n in (1, 4))
    np.testing.assert_array_equal(one, four)


def test_pixels_made_together_are_those_made_one_by_one():
    """A faint pixel has its neighbours made one by one; those before it have drawn the same numbers."""
    light_e = np.linspace(0.0, 5e4, 20 * 150).reshape(20, 150).astype(np.float32)
    faint_e = light_e.copy()
    faint_e[:, -1], faint_e[:, 100] = -90.0, -90.0
    sky, detector = [100.0, 0.1, 0.2], [1.3, 10.0, 500.0, 4e4]
    together, alone = (metrology.expose(e, sky, detector, seed=5) for e in (light_e, faint_e))
    np.testing.assert_array_equal(together[:, :100], alone[:, :100])
    assert (together[:, 100] != alone[:, 100]).all()
