"""Every door that bytes come in by, fuzzed for a short while; ``python -m bench.fuzz`` does it for long."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from random import Random

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from bench.fuzz import replay
from bench.fuzz_mutations import mutate_bytes, mutate_json, mutate_toml
from bench.fuzz_targets import Broken, Target, require, targets
from bench.fuzz_worker import Watch
from ssm_service.errors import SsmError

EXAMPLES = {"robot": 25, "scenario": 25, "zenoh": 40, "evaluate/lines": 30, "evaluate/query": 30}
"""For the slow ones; the others have 60."""

randoms = st.randoms(use_true_random=False)


@pytest.mark.parametrize("name", sorted(targets()))
def test_a_door(name: str) -> None:
    """What is valid passes; what was changed is refused in our own words or is as good as valid."""
    target = targets()[name]
    for valid in target.seeds():
        assert target.run(valid), valid
    inputs = st.sampled_from(target.seeds())

    @settings(
        derandomize=True,
        database=None,
        deadline=None,
        max_examples=EXAMPLES.get(name, 60),
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate],  # what breaks is small enough, and shrinking takes long
    )
    @given(inputs, randoms, st.binary(max_size=60), st.integers(0, 5))
    def fuzz(seed: bytes, random: Random, noise: bytes, kind: int) -> None:
        data = (
            noise if kind == 0 else mutate_bytes(seed, random) if kind == 1 else target.mutate(seed, random)
        )
        begin = time.monotonic()
        target.run(data)
        assert time.monotonic() - begin < 20.0

    fuzz()


@pytest.mark.parametrize("mutate", [mutate_json, mutate_toml, mutate_bytes])
def test_a_mutation_is_its_seeds_and_most_change_something(mutate) -> None:
    data = b'{"a": [1, 2.5, null], "b": {"c": "d"}}\nx = [1, 2]\n'
    made = [mutate(data, Random(seed)) for seed in range(200)]
    assert made == [mutate(data, Random(seed)) for seed in range(200)]
    assert len(set(made)) > 100


def planted(data: bytes) -> bool:
    """Let a door break in two places."""
    if data.startswith(b"slow"):
        end = time.process_time() + 0.02
        while time.process_time() < end:
            pass
    require(not data.startswith(b"x"), "no x")
    return data.decode() == "ok"


def test_a_planted_hole_is_found_kept_and_told_apart(tmp_path: Path) -> None:
    target = Target(name="planted", run=planted, seeds=lambda: [b"ok"], mutate=mutate_bytes, slow_s=0.01)
    watch = Watch(target, tmp_path)
    for data in (b"ok", b"no", b"x1", b"x2", b"\xff", *[b"ok"] * 10, b"slow"):
        watch.run(data)
    assert (watch.runs, watch.accepted) == (16, 11)
    kept = {path.read_bytes() for path in tmp_path.glob("crash-*") if path.suffix != ".txt"}
    assert kept == {b"x1", b"\xff", b"slow"}
    assert any("no x" in path.read_text() for path in tmp_path.glob("*.txt"))
    with pytest.raises(Broken, match="no x"):
        planted(b"x")


def test_a_kept_input_is_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    good, bad = tmp_path / "crashes/message/Zone/crash-1", tmp_path / "crashes/planted/crash-2"
    for path, data in ((good, b"{}"), (bad, b"x")):
        path.parent.mkdir(parents=True)
        path.write_bytes(data)
    everything = targets() | {
        "planted": Target(name="planted", run=planted, seeds=lambda: [b"ok"], mutate=mutate_bytes)
    }
    monkeypatch.setattr("bench.fuzz.targets", lambda: everything)
    assert replay([good, bad]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].endswith("refused, as it must be")
    assert said[1].endswith("Broken: no x")


def test_a_refusal_is_one_of_ours() -> None:
    """The doors let ``SsmError`` be a refusal; what stands for everything else here must not be one."""
    assert not issubclass(Broken, SsmError)
