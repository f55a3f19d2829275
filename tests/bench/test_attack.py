"""The campaign of hostile inputs: a hundred variants do not fall, and faults that are planted are found."""

import mmap
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import bench.attacking.campaign
import bench.attacking.children
import bench.attacking.verdicts
from bench.attacking.campaign import Campaign, known_results, run_campaign
from bench.attacking.children import CommandOutcome
from bench.attacking.targets import TARGETS
from bench.attacking.verdicts import FALLEN, Verdict, is_one_sentence, verdict

ROOT = Path(__file__).resolve().parents[2]
PLANS = tuple(target for target in TARGETS if target.command == "eval --plans, CSV")
FINISHED = CommandOutcome(0, "", "", 1.0, 1.0, 20.0, 1 << 28)


@pytest.mark.slow
def test_a_hundred_variants_of_files_and_doors_are_answered(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "bench" / "attack.py"), "--count", "120", "--folder", str(tmp_path)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    files, doors = (known_results(tmp_path / path) for path in ("files/results-0.jsonl", "doors/doors-0.jsonl"))
    assert len(files) == len(doors) == 60
    assert {each.kind for each in files.values()} == {target.kind for target in TARGETS}
    assert all(sum(each.verdict == Verdict.ANSWERED for each in found.values()) > 35 for found in (files, doors))
    assert "| all | 120 |" in done.stdout
    assert not [path for path in tmp_path.glob("*/*") if path.name.startswith(("case-", "door-"))]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return Campaign(tmp_path_factory.mktemp("attack"), 3, PLANS)


def verdicts(campaign: Campaign, *numbers: int) -> set[str]:
    return {result.verdict for result in run_campaign(campaign, numbers, again=True)}


def test_what_this_process_holds_is_not_the_commands(campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    held = bytearray(b"1") * (600 << 20)
    for module in (bench.attacking.children, bench.attacking.verdicts):
        monkeypatch.setattr(module, "MEMORY_BYTES", 500 << 20)
    assert Verdict.MEMORY not in verdicts(campaign, 0)
    del held


def test_a_reader_that_raises_is_found(campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path) -> Any:
        raise ValueError(path)

    assert not verdicts(campaign, 0, 1, 2) & set(FALLEN)
    monkeypatch.setattr("adapters.plan_file.read_plan_file", broken)
    assert verdicts(campaign, 0, 1, 2) == {Verdict.TRACEBACK}


def test_a_reader_that_makes_up_what_it_cannot_read_is_found(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    import adapters.plan_file
    from benchmark.errors import InputError

    honest: Callable[..., Any] = adapters.plan_file.read_plan_file

    def obliging(path: Path, *frame: Any) -> Any:
        try:
            return honest(path, *frame)
        except InputError:
            other = path.with_name("other.csv")
            other.write_text((campaign.valid / "plans.csv").read_text().replace("7.5", "8.5"))
            return honest(other, *frame)

    monkeypatch.setattr("adapters.plan_file.read_plan_file", obliging)
    assert Verdict.SILENT in verdicts(campaign, 2)


def _sleep() -> int:
    time.sleep(30)
    return 2


def _take_memory() -> int:
    # Not from the heap, of which a process that keeps its pages may have as much to spare.
    with mmap.mmap(-1, 800 << 20, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as held:
        for place in range(0, len(held), mmap.PAGESIZE):
            held[place] = 1
        time.sleep(0.2)
    print("error: too late", file=sys.stderr)
    return 2


def _die() -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 2


def _write() -> int:
    place = Path(sys.argv[sys.argv.index("--out") + 1])
    place.mkdir(parents=True)
    (place / "half").touch()
    print(f"error: {place.parent / 'plans.csv'} is bad; make it again", file=sys.stderr)
    return 2


def _mumble() -> int:
    print("error: something is wrong", file=sys.stderr)
    return 2


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (_sleep, Verdict.HANG),
        (_take_memory, Verdict.MEMORY),
        (_die, Verdict.DEATH),
        (_write, Verdict.WROTE),
        (_mumble, Verdict.UNCLEAR),
    ],
)
def test_every_way_to_fall_is_seen(
    campaign: Campaign, fault: Callable[[], int], found: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (bench.attacking.children, bench.attacking.verdicts):
        monkeypatch.setattr(module, "MEMORY_BYTES", 500 << 20)
    monkeypatch.setattr(bench.attacking.children, "patience_s", lambda: 2.0)
    monkeypatch.setattr(bench.attacking.children, "_run", fault)
    assert verdicts(campaign, 0) == {found}


def test_the_same_seed_makes_the_same_variants(tmp_path: Path, campaign: Campaign) -> None:
    def variant(of: Campaign, number: int) -> tuple[str, bytes]:
        _, _, attack = of.attack(number)
        file = tmp_path / "plans.csv"
        file.write_bytes((campaign.valid / "plans.csv").read_bytes())
        attack.change(file, file)
        # Some are 20 GB of nothing.
        with file.open("rb") as stream:
            return attack.name, stream.read(100_000)

    again, other = Campaign(campaign.folder, 3, PLANS), Campaign(campaign.folder, 4, PLANS)
    numbers = range(0, 24)
    assert [variant(campaign, number) for number in numbers] == [variant(again, number) for number in numbers]
    assert [variant(campaign, number) for number in numbers] != [variant(other, number) for number in numbers]


def test_refusals_are_one_sentence_that_names_the_path(tmp_path: Path) -> None:
    places = (tmp_path,)
    assert is_one_sentence(f"error: {tmp_path}/a is bad; make it again\n", places)
    notice = "split adv, the default; --split chooses another"
    for before in ("warning: slow", "importing scenes: 0 of 1 scene, 0:02", notice):
        assert is_one_sentence(f"{before}\nerror: {tmp_path}/a is bad; make it again\n", places)
    for said in (
        "error: a is bad\n",
        f"error: {tmp_path} is bad",
        f"error: {tmp_path} is\nbad\n",
        f"error: {tmp_path} is \x1b[1m\n",
        f"error: {tmp_path} {'x' * 2000}\n",
        f"{tmp_path}\n",
        "",
    ):
        assert not is_one_sentence(said, places), said


def test_other_numbers_are_a_fall_unless_the_variant_may_be_valid(tmp_path: Path) -> None:
    target = replace(PLANS[0], numbers=lambda _, __: "other")

    def found(*, may_be_valid: bool, valid: str = "numbers") -> Verdict:
        return verdict(target, FINISHED, valid, tmp_path, (tmp_path,), may_be_valid=may_be_valid)

    assert found(may_be_valid=False) == Verdict.SILENT and found(may_be_valid=True) == Verdict.OTHER_INPUT
    assert found(may_be_valid=False, valid="other") == Verdict.SAME
