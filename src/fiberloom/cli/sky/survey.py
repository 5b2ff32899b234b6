"""`fiberloom sky survey`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, naming, require_file
from fiberloom.cli.terminal import waiting
from fiberloom.report.folder import prepare_folder

if TYPE_CHECKING:
    from fiberloom.assignment.visits.survey import SurveyPlan
    from fiberloom.instruments import FocalPlane
    from fiberloom.sky.sky_field import SkyField
    from fiberloom.targets.survey_file import SurveyFile
    from fiberloom.typing import Ints


class Solver(StrEnum):
    """What chooses."""

    highs = "highs"
    ortools = "ortools"
    greedy = "greedy"


@dataclass(frozen=True, kw_only=True)
class SurveyOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom sky survey`."""

    survey: Annotated[
        Path, typer.Argument(help="TOML file: targets, pointings with their field files, sectors, minimum.")
    ]
    solver: Annotated[
        Solver, typer.Option(help="highs; ortools (pip install 'fiberloom[survey]'); or greedy, no bound.")
    ] = Solver.highs
    out: Annotated[Path, typer.Option(help="Folder for lists and fields of the exposures.")] = Path("survey")


def survey(options: SurveyOptions) -> int:
    """Choose the targets of many exposures together: visits by priority, least numbers per sector.

    Writes for each exposure the list and the field that `observe` and `assign` take. Exit code 1
    where a minimum is missed once the other positioners are parked.
    """
    from fiberloom.assignment.visits.solve import require_solver

    require_file(options.survey)
    options.check_plane()
    require_solver(options.solver.value)
    from fiberloom.assignment.visits.survey import SurveyList, VisitSettings, plan_survey
    from fiberloom.drive.way_rules import way_rule
    from fiberloom.targets.survey_file import SurveyFile, SurveyTargets, exposures_of

    file = SurveyFile.read(options.survey)
    plane = options.plane()
    targets = SurveyTargets.read(file.targets)
    made = exposures_of(file, targets, plane.instrument)
    prepare_folder(options.out)
    sky = targets.sky.targets
    wanted = SurveyList(sky.target_id, sky.priority, targets.visits, targets.role)
    with waiting(options.as_json) as wait, naming(options.survey):
        how = VisitSettings(
            minimum=file.minimum,
            sectors=file.sectors,
            solver=options.solver.value,
            ways=way_rule(plane),
            progress=wait.say,
        )
        exposures = [(seen, rows) for _, seen, rows in made]
        found = plan_survey(plane, wanted, exposures, seed=options.seed, settings=how)
    guides = [targets.guides(seen) for _, seen, _ in made]
    _write(options.out, file, found, [field for field, _, _ in made], guides, plane)
    report = _report(found, plane) | {"folder": str(options.out)}
    options.show(report)
    return 0 if report["minimums_missed"] == [] else 1


def _report(found: SurveyPlan, plane: FocalPlane) -> dict[str, Any]:
    import math

    others = found.others()
    done = found.completeness()
    by_role = found.by_role(plane)
    return {
        "exposures": len(found.assignments),
        "candidates": len(found.model),
        "assigned": [a.n_assigned for a in found.assignments],
        "solver": found.settings.solver,
        "value": found.chosen.value,
        "bound": None if math.isinf(found.chosen.bound) else found.chosen.bound,
        "gap_percent": None if math.isinf(found.chosen.gap) else 100.0 * found.chosen.gap,
        "proven": found.chosen.proven,
        "cpu_s": found.chosen.cpu_s,
        "value_of_others": {name: None if one is None else one.value for name, one in others.items()},
        "given_up_for_parking": int(found.chosen.columns.sum())
        - sum(a.n_assigned for a in found.assignments),
        "fewest_in_a_sector": {name: min(map(min, per)) for name, per in by_role.items()},
        "minimums_missed": _missed(found, by_role),
        "by_priority": [_line(row) for row in done],
    }


def _line(row: dict[str, Any]) -> str:
    return (
        "priority {priority:g}: {complete} of {targets} targets complete, "
        "{visits_done} of {visits_wanted} visits"
    ).format(**row)


def _missed(found: SurveyPlan, by_role: dict[str, list[list[int]]]) -> list[str]:
    """Minimums that the parking of others has cost."""
    return [
        f"exposure {e + 1}, sector {s + 1}: {number} {role} of {found.settings.minimum[role]}"
        for role, per in by_role.items()
        for e, counts in enumerate(per)
        for s, number in enumerate(counts)
        if number < found.settings.minimum[role]
    ]


def _write(
    out: Path,
    file: SurveyFile,
    found: SurveyPlan,
    fields: list[SkyField],
    guides: list[Ints],
    plane: FocalPlane,
) -> None:
    """A list and a field for each exposure, and what each target gets; `guides`: rows of guide stars."""
    import numpy as np

    from fiberloom.report.outputs import marks
    from fiberloom.sky.sky_targets import GUIDE
    from fiberloom.tables import write_columns

    for number, (field, rows, assignment) in enumerate(
        zip(fields, found.rows, found.assignments, strict=True), start=1
    ):
        field.write(out / f"field-{number:02d}.toml")
        has = assignment.target >= 0
        own = guides[number - 1]
        more = {
            "positioner_id": [*plane.positioner_id[has].tolist(), *len(own) * [""]],
            "fibre": [*assignment.fibre[has].tolist(), *len(own) * [GUIDE]],
        }
        taken = np.concatenate([rows[assignment.target[has]], own])
        _write_list(out / f"exposure-{number:02d}.csv", file.targets, taken, more)
    wanted = found.survey
    columns: dict[str, Any] = {
        "target_id": wanted.target_id,
        "role": wanted.role,
        "priority": wanted.priority,
        "visits_wanted": wanted.visits,
        "visits_done": found.visits_done,
    }
    write_columns(out / "visits.ecsv", columns, marks(plane, found.seed))


def _write_list(path: Path, source: Path, rows: Any, more: dict[str, list[Any]]) -> None:
    from fiberloom.targets.survey_file import list_of
    from fiberloom.wholefile import write_whole

    head, lines = list_of(source, rows, more)
    write_whole(path, "\n".join(",".join(cells) for cells in [head, *lines]) + "\n")
