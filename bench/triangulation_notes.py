"""What one must know to read the numbers of the sweep."""

from __future__ import annotations

from ssm_service.config import AssumptionsConfig
from ssm_service.model import Robot

from .common import Row
from .triangulation_chunk import Settings
from .triangulation_estimators import BOUNDS
from .triangulation_noise import DROPPED, NOISES
from .triangulation_person import ASIDE_M, TABLE_M
from .triangulation_report import lost
from .triangulation_scenes import AXIAL_M, FOREARM_M, GAP_M, HAND_M, RADIUS_M

NOTES = f"""\
Scenes: free joints uniform in ±π within their limits; gap (radial, from the ring's cylinder of {{radius}} \
m) uniform in {GAP_M[0]} to {GAP_M[1]} m, any bearing, axial offset uniform in ±{AXIAL_M} m. Balls of \
{RADIUS_M} m; forearms are capsules of {FOREARM_M[0]} m, {FOREARM_M[1]} m between the caps' centres, hands \
boxes of {" × ".join(map(str, HAND_M))} m, both turned in any way and nearest to the ring's axis at gap and \
offset as drawn.
The person stands on a floor {TABLE_M} m below the arm's base and walks towards the ring with an arm \
stretched out, up to {ASIDE_M} m to its side, until the drawn gap is left to the link's real surface; \
there, gap, bearing and axial offset are those of the person's nearest point.
Readings are those of the obstacle alone: the arm's own links do not stand in the cones.
Noise: {{noises}}.
Errors are the estimate less Coal's distance, in mm; over-estimates are the unsafe side. The truth is the \
mesh of {{link}}; as_printed, corrected and nearest speak of the ring's cylinder instead. Percentiles are \
over the scenes with an answer, so compare estimators on 'two or more echoes', where they answer on the \
same scenes.
Whole arm: {{arm}}. Scenes in which the obstacle touches what is measured are counted and left out.
Bearing: against that of the obstacle's point nearest to the link; median of the absolute error.
Zones of profile {{profile}}; no answer counts as green, as the profile takes silence. Unsafe: a milder \
zone than Coal's, as a share of all scenes. A bound answers to silence, too; readings that contradict its \
assumptions are a stop, and count as red.
sphere_fit assumes balls of {{assumed}} m. lower_bound takes for granted what the robot file declares: one \
obstacle, a ball of {{least}} to {{most}} m, readings within {{error}} m; lower_bound_tight the same, but \
readings that err no more than the row's noise does. The bounds' median below 0 is the price of the ring.
Drop-outs ({DROPPED:.0%} of the echoes) and shapes other than balls are outside of what lower_bound \
promises: the table shows what happens then.
Strata overlap: all, gap, bearing off the nearest sensor's axis, axial offset, number of echoes. Everything \
by shape, noise, stratum and estimator is in the JSON.
"""

WHY = (
    "Why: a single ring does not tell where along the link's axis an obstacle is. sphere_fit takes a typical "
    "offset from the ring's plane, of a ball of its assumed radius: what is in that plane it puts too near, "
    "what is farther off too far, and a forearm or a trunk is no such ball. Where resampling favours neither "
    "side, the stratum is too small to tell."
)


def notes(robot: Robot, settings: Settings, rows: list[Row], contests: list[Row]) -> list[str]:
    """Return the notes, one for each line."""
    array = robot.sensor_arrays[0]
    every = settings.arm_every
    arm = {0: "no ball scene", 1: "every scene"}.get(every, f"one ball scene in {every}, every other scene")
    assumptions = robot.config.file.assumptions or AssumptionsConfig(reading_error_m=0.0)
    assumed = assumptions.assumed_radius_m
    text = NOTES.format(
        assumed=assumptions.radius_min_m if assumed is None else assumed,
        least=assumptions.radius_min_m,
        most=assumptions.radius_max_m,
        error=assumptions.reading_error_m,
        radius=array.rings[0].radius,
        noises="; ".join(f"{name}: {NOISES[name]}" for name in settings.noises),
        link=array.link,
        arm=arm,
        profile=robot.config.file.default_profile,
    )
    better = [f"sphere_fit is not better in both median and p95: {line}." for line in lost(contests)]
    if better:
        better.append(WHY)
    return [*text.splitlines(), *_kept(rows), *better]


def _kept(rows: list[Row]) -> list[str]:
    """Return how often the bounds were above the truth where they promise not to be."""
    lines = []
    for name in sorted({row["estimator"] for row in rows} & set(BOUNDS)):
        promised = [
            row
            for row in rows
            if row["estimator"] == name
            and (row["shape"], row["kind"], row["truth"]) == ("sphere", "all", "link")
            and row["noise"] != "drop-outs"
        ]
        scenes = sum(row["scenes"] for row in promised)
        broken = sum(round((row["over"] or 0.0) * row["answered"]) for row in promised)
        silent = scenes - sum(row["answered"] for row in promised)
        lines.append(
            f"{name}, balls without drop-outs: above Coal's distance in {broken} of {scenes} scenes, "
            f"contradicted in {silent}."
        )
    return lines
