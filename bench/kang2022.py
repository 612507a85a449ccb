"""Does the 3-D field with speed zones do on the UR3 what [Kang2022] reports, and where does it not?

The reduced UR3 goes along a straight line past a ball of 5 cm, which only its sensor ring sees. The
direction is the field's, the speed that of a line with parabolic blends, sampled every 0.01 s, and the zones'
limits are those of the service's own monitor. Each row runs ideal, and as a real robot with lag, noise, a
slow scan and a link at 125 Hz. Besides, the ball at random places shows how often either method arrives.
"""

from __future__ import annotations

import time
from pathlib import Path

from .common import Report, parser, progress
from .kang2022_figures import draw_all
from .kang2022_places import draw, place_notes, run_places
from .kang2022_run import Run, run
from .kang2022_scene import CASES, FREE, PLANTS, Case, scene
from .kang2022_table import COLUMNS, IDEAL, notes, table


def main() -> None:
    """Run the benchmark."""
    options = parser("kang2022", __doc__, "places", 12, "other places of the ball")
    options.add_argument(
        "--repeats", type=int, default=3, help="seeds of the real robot's noise (default: %(default)s)"
    )
    arguments = options.parse_args()
    if arguments.repeats < 1:
        options.error("--repeats must be 1 or more")
    begin = time.perf_counter()
    found: dict[tuple[str, bool, str], list[Run]] = {}
    with progress() as bar:
        rows = bar.add_task("rows", total=len(CASES) * (1 + arguments.repeats))
        for method, limited in CASES:
            for plant in PLANTS:
                seeds = [arguments.seed + i for i in range(1 if plant == IDEAL else arguments.repeats)]
                runs = found[method, limited, plant] = []
                for seed in seeds:
                    runs.append(run(Case(method=method, limited=limited, plant=plant, seed=seed)))
                    bar.advance(rows)
        (free,) = found[FREE, True, IDEAL]
        others = bar.add_task("places", total=arguments.places)
        places = run_places(draw(free, arguments.places, arguments.seed), lambda: bar.advance(others))
    lines = table(found)
    first = {key: runs[0] for key, runs in found.items()}

    def draw_figures(path: Path) -> None:
        draw_all(path.parent, first)

    Report(
        name="kang2022",
        settings={
            "seed": arguments.seed,
            "repeats": arguments.repeats,
            "places": arguments.places,
            "ball": " ".join(f"{value:g}" for value in scene().ball_m),
            "seconds": round(time.perf_counter() - begin, 1),
        },
        columns=COLUMNS,
        rows=lines,
        notes=[*notes(lines), *place_notes(places)],
        draw=draw_figures,
    ).finish(arguments)


if __name__ == "__main__":
    main()
