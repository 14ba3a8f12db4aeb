import pytest

from autolights.evaluate.errors_by_cause import causes


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        pytest.param("R:R R?:- R?:G", [None, "occluded", "occluded"], id="hidden"),
        pytest.param("fl*:off fl*?:off", ["flashing", "occluded"], id="hidden-goes-before-flashing"),
        pytest.param("R:- R:~R R:R R:-", ["birth", "birth", None, "missed"], id="birth-ends-with-the-first-report"),
        pytest.param("R:R G:R G:-", [None, "transition", "transition"], id="just-changed"),
        pytest.param("R:R R:G", [None, "wrong class"], id="wrong"),
        pytest.param("R:R G:G G:G G:G G:G G:G G:R", [*[None] * 6, "wrong class"], id="half-a-second-later"),
    ],
)
def test_each_error_has_the_first_cause_that_applies(rows, words: str, expected: list[str | None]) -> None:
    assert causes(rows(words)) == expected


def test_a_light_that_one_camera_introduced_is_not_new_to_the_other(rows) -> None:
    outcomes = rows("R:R") + rows("R:-", camera="wide", start_s=0.02)
    assert causes(outcomes) == [None, "missed"]
    assert causes(outcomes[::-1]) == ["missed", None], "the order of the rows does not matter"
