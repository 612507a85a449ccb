"""Fuzzes one target in a process of its own, guided by coverage where Atheris is installed."""

from __future__ import annotations

import hashlib
import json
import sys
import time
import traceback
from pathlib import Path
from random import Random
from typing import Any

COMPILED = ("perception", "model", "motion")
"""Rooms with compiled functions, which cannot be instrumented: coverage counts in all others."""

MAX_BYTES = 8192


class Watch:
    """Runs inputs, and keeps those that break something, one for each place that breaks.

    Args:
        target: From ``fuzz_targets``.
        folder: For the crashes of this target.
    """

    def __init__(self, target: Any, folder: Path) -> None:
        self._target, self._folder = target, folder
        self._seen: set[str] = set()
        self.runs = self.accepted = 0
        self.worst_s = 0.0

    def run(self, data: bytes) -> None:
        """Run one input; whatever it breaks is written down, and the fuzzing goes on."""
        begin = time.process_time()  # of work, whoever else has the machine
        try:
            self.accepted += self._target.run(data)
        except Exception as error:
            self._found(data, error, traceback.format_exc())
        took_s = time.process_time() - begin
        if took_s > self._target.slow_s and self.runs > 10:
            self._found(data, TimeoutError("slow"), f"it took {took_s:.1f} s")
        self.worst_s = max(self.worst_s, took_s if self.runs > 10 else 0.0)
        self.runs += 1

    def _found(self, data: bytes, error: Exception, text: str) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        place = f"{type(error).__name__} {frames[-1].filename}:{frames[-1].lineno}" if frames else str(error)
        if place in self._seen:
            return
        self._seen.add(place)
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"crash-{hashlib.sha256(data).hexdigest()[:16]}"
        path.write_bytes(data)
        path.with_suffix(".txt").write_text(text, encoding="utf-8")

    def say(self) -> None:
        """Write the counts to stdout as one JSON line."""
        counts = {"runs": self.runs, "accepted": self.accepted, "worst_s": self.worst_s}
        print(json.dumps({**counts, "crashes": len(self._seen)}), flush=True)


def main() -> None:
    """Run one target: ``NAME SECONDS SEED CORPUS CRASHES ENGINE``."""
    name, seconds, seed, corpus, crashes, engine = sys.argv[1:]
    Path(corpus).mkdir(parents=True, exist_ok=True)
    guided = {"atheris": _atheris, "hypothesis": _hypothesis}[engine]
    guided(name, float(seconds), int(seed), Path(corpus), Path(crashes))


def _atheris(name: str, seconds: float, seed: int, corpus: Path, crashes: Path) -> None:
    import atheris

    import ssm_service

    package = Path(ssm_service.__file__).parent
    rooms = [package / room for room in COMPILED]
    excluded = [f"ssm_service.{path.parent.name}.{path.stem}" for room in rooms for path in room.glob("*.py")]
    with atheris.instrument_imports(include=["ssm_service"], exclude=excluded, enable_loader_override=False):
        from .fuzz_targets import targets

        target = targets()[name]
    watch = Watch(target, crashes)
    _seed_corpus(target, corpus)
    end = time.monotonic() + seconds

    def one(data: bytes) -> None:
        watch.run(data)
        if time.monotonic() > end:
            _leave(watch)

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        random = Random(seed)
        changed = target.mutate(data, random) if random.random() < 0.7 else atheris.Mutate(data, most)
        return bytes(changed[:most])

    options = [f"-max_len={MAX_BYTES}", f"-seed={seed}", "-timeout=60", "-verbosity=0", "-rss_limit_mb=0"]
    options += [f"-artifact_prefix={crashes}/hang-", "-print_final_stats=0"]
    atheris.Setup([sys.argv[0], str(corpus), *options], one, custom_mutator=mutate)
    atheris.Fuzz()


def _hypothesis(name: str, seconds: float, seed: int, corpus: Path, crashes: Path) -> None:
    from hypothesis import HealthCheck, given, settings
    from hypothesis import seed as seeded
    from hypothesis import strategies as st

    from .fuzz_targets import targets

    target = targets()[name]
    watch = Watch(target, crashes)
    _seed_corpus(target, corpus)
    kept = [path.read_bytes() for path in sorted(corpus.iterdir())]
    end = time.monotonic() + seconds
    quick = settings(max_examples=200, database=None, deadline=None, suppress_health_check=list(HealthCheck))

    def one(data: bytes, random: Random) -> None:
        changed = target.mutate(data, random)[:MAX_BYTES]  # drawn in any case: Hypothesis compares
        if time.monotonic() < end:
            watch.run(changed)

    inputs = st.sampled_from(kept) | st.binary(max_size=300)
    while time.monotonic() < end:
        seed += 1
        seeded(seed)(quick(given(inputs, st.randoms(use_true_random=False))(one)))()
    _leave(watch)


def _seed_corpus(target: Any, corpus: Path) -> None:
    for data in target.seeds():
        target.run(data)  # what is built or compiled at first counts as nobody's time
        (corpus / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)


def _leave(watch: Watch) -> None:
    import os

    watch.say()
    sys.stderr.flush()
    os._exit(0)  # libFuzzer would never return, and the evaluating process's thread never ends


if __name__ == "__main__":
    main()
