from pathlib import Path

import pytest

from autolights.demo.stages import Stages


class Job:
    """Two stages that count how often they work; the second copies what the first made."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.calls: list[str] = []

    def run(self, setting: str = "a") -> None:
        stages = Stages(self.root)
        stages.run("first", [self.root / "first.txt"], setting, self._first)
        stages.run("second", [self.root / "second"], None, self._second)

    def _first(self) -> None:
        self.calls.append("first")
        (self.root / "first.txt").write_text(f"made {len(self.calls)}")

    def _second(self) -> None:
        self.calls.append("second")
        (self.root / "second").mkdir(exist_ok=True)
        (self.root / "second" / "copy.txt").write_text((self.root / "first.txt").read_text())


@pytest.fixture
def job(tmp_path: Path) -> Job:
    made = Job(tmp_path)
    made.run()
    made.calls.clear()
    return made


def test_unchanged_results_are_kept(job: Job) -> None:
    job.run()
    assert job.calls == []


def test_other_settings_redo_the_stage_and_all_after_it(job: Job) -> None:
    job.run(setting="b")
    assert job.calls == ["first", "second"]


def test_a_deleted_result_is_made_again(job: Job) -> None:
    (job.root / "second" / "copy.txt").unlink()
    job.run()
    assert job.calls == ["second"]


def test_an_edited_result_is_made_again_and_so_is_what_depends_on_it(job: Job) -> None:
    (job.root / "first.txt").write_text("edited by hand")
    job.run()
    assert job.calls == ["first", "second"]


def test_a_stage_that_failed_runs_again(job: Job, tmp_path: Path) -> None:
    def fail() -> None:
        (tmp_path / "third.txt").write_text("half")
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        Stages(tmp_path).run("third", [tmp_path / "third.txt"], None, fail)
    worked = []
    Stages(tmp_path).run("third", [tmp_path / "third.txt"], None, lambda: worked.append(True))
    assert worked == [True]


def test_a_damaged_record_counts_as_never_run(job: Job) -> None:
    (job.root / ".stages" / "first.json").write_text("{")
    job.run()
    assert job.calls[0] == "first"


def test_minutes_are_remembered(job: Job) -> None:
    stages = Stages(job.root)
    stages.run("first", [job.root / "first.txt"], "a", lambda: pytest.fail("should be skipped"))
    assert set(stages.minutes) == {"first"}
