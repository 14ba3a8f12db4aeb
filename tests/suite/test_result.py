import pytest

from autolights.core import load_config
from autolights.core.errors import UsageError
from autolights.pipeline import PipelineConfig
from autolights.suite import SuiteConfig, SuiteResult, comparison, default_pipelines, markdown, run_suite


@pytest.fixture(scope="module")
def result(suite: SuiteConfig) -> SuiteResult:
    pipelines = default_pipelines(
        load_config("runtime/default", PipelineConfig), load_config("runtime/paper", PipelineConfig)
    )
    return run_suite(suite, pipelines, scenarios=["plain", "late"])


def test_memory_helps(result: SuiteResult) -> None:
    plain = {label: of.accuracy.percent or 0.0 for label, of in result.scenarios["plain"].items()}
    assert plain["full"] > plain["od"] + 3
    assert plain["paper"] > plain["od"]


def test_the_whole_is_the_sum_of_its_scenarios(result: SuiteResult) -> None:
    for label, whole in result.whole.items():
        assert whole.accuracy.total == sum(of[label].accuracy.total for of in result.scenarios.values())


def test_plain_distance_is_the_same_for_all_pipelines(result: SuiteResult) -> None:
    assert len({of.plain_pairing.count for of in result.scenarios["plain"].values()}) == 1
    assert result.scenarios["plain"]["full"].pairing.percent == pytest.approx(100, abs=1)


def test_targets_without_their_scenario_are_open(result: SuiteResult) -> None:
    verdicts = {verdict.name: verdict for verdict in result.verdicts}
    assert verdicts["association with 1° mounting error, %"].met is None
    assert verdicts["class accuracy, %"].value == result.whole["full"].accuracy.percent
    # Too few light-frames prove nothing.
    assert verdicts["unsafe reports in at least 100,000 light-frames"].met is False


def test_the_table_names_everything(result: SuiteResult) -> None:
    text = markdown(result)
    assert "| class accuracy, % | ≥ 98.0 |" in text
    assert "2 scenarios, 2 drives." in text
    assert "**plain**: plain" in text
    assert "|  | od | fusion | full | paper |" in text


def test_reads_back(result: SuiteResult, tmp_path: object) -> None:
    path = tmp_path / "suite.json"  # type: ignore[operator]
    result.save(path)
    assert SuiteResult.load(path) == result


def test_misuse(suite: SuiteConfig) -> None:
    pipelines = {"full": PipelineConfig()}
    with pytest.raises(UsageError, match="no scenario 'fog'"):
        run_suite(suite, pipelines, scenarios=["fog"])
    with pytest.raises(UsageError, match="no pipeline 'B' to be judged; there are full"):
        run_suite(suite, pipelines, judged="B")


def test_two_configurations_side_by_side(suite: SuiteConfig) -> None:
    lax = PipelineConfig()
    blind = PipelineConfig(fusion_score_threshold=0.99)
    result = run_suite(suite, {"A": lax, "B": blind, "A2": lax}, scenarios=["plain", "turned"], judged="B")
    same, worse = comparison(result, "A", "A2"), comparison(result, "A", "B")
    assert "class accuracy +0.00 points" in same
    assert "better on 0, worse on 2" in worse


def test_a_class_that_no_description_knows_is_a_slip(suite: SuiteConfig) -> None:
    slip = suite.model_copy(update={"confusion": {**suite.confusion, "3-gren": {"3-red": 0.1}}})
    with pytest.raises(UsageError, match="confusion names '3-gren'"):
        run_suite(slip, {"full": PipelineConfig()}, scenarios=["plain"])
