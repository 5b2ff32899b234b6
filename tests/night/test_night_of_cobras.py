"""A night of cobras: those that the calibration does not count on get no target, as in an observation."""

import asyncio

from nights import Night

from fiberloom.night import carry
from fiberloom.night.asked.orders import ADD, SKIP
from fiberloom.night.queue import read_queue
from fiberloom.operation.past.parts import ASSIGNMENT, assignment_of
from fiberloom.store.service.alarms import Severity
from fiberloom.store.service.commands import CommandBook, CommandResult

STUCK, COLLIDED = 3, 801
FIELDS = "".join(
    f'[[field]]\nid = "{name}"\ntargets = "{name}.csv"\nexposure_s = 60\ncorrections = 8\n' for name in "ab"
)


def test_a_stuck_cobra_gets_no_target_in_any_field_also_after_another_one_was_left_out(tmp_path):
    night = Night(tmp_path, FIELDS, faults=f"dead=#{STUCK}", instrument="pfs")
    setup = night.setup()

    def collide(text):
        if text == "expose 1":
            for _ in range(2):
                now, subject = night.book.about.utc_start, f"positioner {COLLIDED}"
                night.book.raise_alarm(now, "collision", Severity.CRITICAL, subject, "it has collided")

    assert night.run(setup=setup, progress=collide).status == "finished"
    assert setup.known.doubtful[STUCK].endswith("its fibre does not move")
    assert setup.known.scatter is not None
    (told,) = [a for a in night.book.alarms() if a.code == "not counted on"]
    assert (told.severity, f"{STUCK} (theta: its fibre does not move)" in told.text) == ("advice", True)
    offline = set(setup.known.plane.positioner_id[setup.known.plane.offline].tolist())
    assert offline == {*setup.known.doubtful, COLLIDED}
    visits = night.book.visits()
    assert {v.field for v in visits if v.state == "done"} == {"a", "b"}
    left_out = setup.known.plane.index_of(sorted(setup.known.doubtful))
    for visit in visits:
        whole, _ = night.store.parts(visit.run_id)
        targets = assignment_of(whole[ASSIGNMENT]).target[left_out]
        assert (targets < 0).all()
        assert visit.assigned >= 4


def test_the_fewest_moves_of_any_field_judge_motors(tmp_path):
    night = Night(tmp_path, FIELDS.replace("corrections = 8\n", "", 1))
    for most, fewest in ((11, 9), (5, 6)):
        assert read_queue(tmp_path / "queue.toml").fewest_moves(most) == fewest
    night.write(FIELDS.replace("corrections = 8\n", ""))
    assert read_queue(tmp_path / "queue.toml").fewest_moves(11) == 12
    night.write(FIELDS.replace("corrections = 8", 'corrections = 2\nskip = "clouds"', 1))
    assert read_queue(tmp_path / "queue.toml").fewest_moves(11) == 9


def test_a_resumed_night_judges_motors_by_the_fields_that_people_have_added_or_left_out(tmp_path):
    night = Night(tmp_path, FIELDS.replace("corrections = 8\n", "", 1), instrument="pfs")
    setup, moves_asked = night.setup(), []

    async def ask(source, progress, moves):
        moves_asked.append(moves)

    setup.known.ask = ask
    book = carry._begun(setup, night.store)
    commands = CommandBook(setup.array.book)

    def order(command, **asked):
        commands.end(commands.begin("ann", "operator", command, asked, night=book.id), CommandResult.DONE)
        asyncio.run(carry._asked(setup, book, lambda _: None))

    asyncio.run(carry._asked(setup, book, lambda _: None))
    order(ADD, id="c", targets=str(tmp_path / "c.csv"), exposure_s=60, corrections=2)
    order(SKIP, field="c")
    assert moves_asked == [9, 3, 9]
