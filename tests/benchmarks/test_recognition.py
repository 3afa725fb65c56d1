"""landfix bench recognition: what its samples are, how answers are judged, what a user sees."""

import dataclasses
import json
import math
from functools import cache
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.recognition import recognisers, views
from benchmarks.recognition.experiments import Trial, below, row
from benchmarks.recognition.partly_seen import hide, shares
from benchmarks.recognition.views import EXPERIMENTS, ROOFS, Experiment, Roof, Sample
from estimator.cli import app
from models import so3
from models.maps import colours
from models.messages import LandmarkFix
from models.prior import Prior
from tests import long
from vision.pipeline import PipelineConfig
from vision.predict import fit, verify
from vision.predict.coarse_search import CoarseConfig
from vision.predict.predict import PredictConfig
from vision.predict.verify import VerifyConfig
from vision.synthetic.render import render_labels
from vision.synthetic.truth import landmark_views


@cache
def sample(experiment: Experiment = "accuracy", roof: Roof = "painted", number: int = 1) -> Sample:
    return views.draw(experiment, roof, 5, number)


@pytest.mark.parametrize(("k", "n", "expected"), [(0, 200, 0.01487), (0, 1, 0.95), (3, 200, 0.03831), (7, 7, 1.0)])
def test_bound_of_a_share(k: int, n: int, expected: float) -> None:
    """Of Clopper and Pearson; for none of n it is 1 - 0.05^(1/n)."""
    assert below(k, n) == pytest.approx(expected, abs=1e-5)


def test_a_sample_follows_from_its_numbers() -> None:
    again, other = views.draw("accuracy", "painted", 5, 1), views.draw("accuracy", "painted", 5, 2)
    np.testing.assert_array_equal(sample().left, again.left)
    assert sample().target == again.target
    assert not np.array_equal(sample().left, other.left)


@pytest.mark.parametrize("experiment", EXPERIMENTS)
@pytest.mark.parametrize("roof", ROOFS)
def test_what_is_asked_for_is_there(experiment: Experiment, roof: Roof) -> None:
    s = sample(experiment, roof)
    assert s.target in s.scene.map
    mark = next(k for k, m in enumerate(s.scene.world.landmarks) if m.id == s.target)
    labels = render_labels(s.scene.world, s.scene.rig.left, *s.scene.rig.camera_pose(s.p_n, s.R_nb))
    assert (labels == mark).sum() > 300
    assert (s.reference is None) == (experiment == "description")
    error = s.prior.p_n - s.p_n
    assert 0.0 < np.abs(error / views.PRIOR_SIGMA[:3]).max() < 5.0


@long.parametrize("number", range(4))
def test_partial_views_show_30_to_70_percent_and_no_landmark_better(number: int) -> None:
    s = sample("partial", "painted", number)
    seen = {name: share for name, share in shares(s.scene.world, s.scene.rig, s.p_n, s.R_nb).items() if name in s.scene.map}
    assert 0.3 <= s.seen <= 0.7
    assert seen[s.target] == pytest.approx(s.seen, abs=0.02)
    assert max(seen.values()) <= 0.72
    assert sum(share >= 0.28 for share in seen.values()) >= 2


def test_share_of_a_whole_roof_is_one() -> None:
    s = sample()
    assert shares(s.scene.world, s.scene.rig, s.p_n, s.R_nb)[s.target] == pytest.approx(1.0, abs=0.06)


def test_towers_hide_what_they_cover() -> None:
    """Seen by the lines of sight, which know nothing of pixels: what lost a part of its share is hidden, what did not is not."""
    s = sample()
    world = hide(s.scene.world, s.scene.rig, s.p_n, s.R_nb, np.random.default_rng(3))
    before, after = (shares(w, s.scene.rig, s.p_n, s.R_nb) for w in (s.scene.world, world))
    hidden = {
        x.id: x.occluded for x in landmark_views(world, s.scene.rig.left, *s.scene.rig.camera_pose(s.p_n, s.R_nb)) if not x.cut
    }
    lost = {name: before[name] - after.get(name, 0.0) for name in hidden if name in before}
    assert max(lost.values()) > 0.1
    for name, share in lost.items():
        assert (hidden[name] > 0.1) >= (share > 0.25)
        assert (hidden[name] > 0.0) or share < 0.02


def test_fusing_a_fix_with_its_prior() -> None:
    """Of equal covariances the mean, half as uncertain; of a worthless fix the prior; a precise fix rules."""
    prior = Prior(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 4.0 * np.eye(6))
    for variance, expected in ((4.0, 1.0), (1e9, 0.0), (1e-9, 2.0)):
        fix = LandmarkFix(
            0, 0, (2.0, -2.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.5 * variance * np.eye(6), 0.5 * variance * np.eye(6), (), 1, 0
        )
        p_n, covariance = recognisers.fused(prior, fix)
        np.testing.assert_allclose(p_n, [expected, -expected, 0.0], atol=1e-6)
        np.testing.assert_allclose(np.diag(covariance), 4.0 * (1.0 - 0.5 * expected), atol=1e-6)


def test_one_texture_comes_in_five_sizes() -> None:
    s = sample("size", "pale")
    assert len(set(s.scene.world.appearances)) == 1
    sizes = {round(m.length_m / 11.0, 2) for m in s.scene.map}
    assert sizes <= {0.7, 0.84, 1.0, 1.19, 1.4}
    assert len(sizes) >= 4


def test_descriptions_know_colours_by_word_or_not_at_all() -> None:
    words = {colours.parse(w) for w in ("firebrick", "royalblue", "gold", "darkorange", "green", "purple", "turquoise", "white")}
    assert {m.colour_bgr for m in sample("description", "painted").scene.map} <= words
    assert {m.colour_bgr for m in sample("description", "pale").scene.map} == {None}


def test_the_next_pair_is_some_way_further_on_and_the_prior_errs_as_before() -> None:
    first, second = sample(), views.later(sample())
    assert 0.1 < np.linalg.norm(second.p_n - first.p_n) < 5.0
    errors = [s.p_n - s.prior.p_n for s in (first, second)]
    assert 0.0 < np.abs(errors[1] - errors[0]).max() < 0.3
    turns = [so3.quat_log(so3.multiply(so3.from_matrix(s.R_nb), so3.conjugate(s.prior.q_nb_wxyz))) for s in (first, second)]
    assert 0.0 < np.abs(turns[1] - turns[0]).max() < 0.01
    assert not np.array_equal(first.left, second.left)
    assert np.linalg.eigvalsh(second.prior.covariance - first.prior.covariance)[0] > 0.0


def test_silence_is_followed_by_a_second_search_and_reported() -> None:
    assert recognisers.landfix(sample(), timed=False).pair == 1
    dark = dataclasses.replace(sample(), left=np.zeros_like(sample().left), right=np.zeros_like(sample().right))
    answer = recognisers.landfix(dark, timed=False)
    assert (answer.verdict, answer.pair) == ("recognised", 2)
    assert recognisers.landfix(dark, timed=False, pairs=1).verdict == "silent"


def test_all_are_asked_again_until_they_answer_and_each_pair_is_another_one() -> None:
    shown: list[Sample] = []

    def method(seen: Sample, timed: bool) -> recognisers.Answer:
        shown.append(seen)
        return recognisers.Answer("wrong" if len(shown) == 3 else "silent", 7.0 if timed else None)

    answer = recognisers.until_heard(method, sample(), timed=True, pairs=4)
    assert (answer.verdict, answer.pair, answer.cpu_ms) == ("wrong", 3, 7.0)
    assert shown[1] is sample().next  # drawn once
    assert len({s.left.tobytes() for s in shown}) == 3
    shown.clear()
    assert recognisers.until_heard(method, sample(), timed=False, pairs=2).verdict == "silent"
    assert len(shown) == 2


@pytest.mark.long
def test_the_others_too_get_the_next_pair() -> None:
    """A dark first pair: SIFT finds the ground in the second one, where it is shown it."""
    dark = dataclasses.replace(sample(), left=np.zeros_like(sample().left), right=np.zeros_like(sample().right))
    checked = recognisers.sift_points(dark.left)
    ground = [recognisers.ask(dark, checked, False, pairs)["SIFT+FLANN, ground"] for pairs in (1, 2)]
    assert [(a.verdict, a.pair) for a in ground] == [("silent", 1), ("recognised", 2)]


def test_a_right_answer_is_recognised_and_a_false_truth_makes_it_wrong() -> None:
    s = sample()
    good = recognisers.landfix(s)
    assert good.verdict == "recognised"
    assert good.error_m is not None
    assert 0.0 < good.error_m < 2.0
    assert good.cpu_ms is not None
    assert good.cpu_ms > 1.0
    moved = dataclasses.replace(s, p_n=s.p_n + np.array([6.0, -5.0, 0.0]))
    assert recognisers.landfix(moved, timed=False).verdict == "wrong"


def test_naming_a_landmark_that_is_gone_is_wrong_and_naming_others_is_not_enough() -> None:
    s = sample()
    bare = dataclasses.replace(s.scene.world, landmarks=(), appearances=())
    assert recognisers.landfix(dataclasses.replace(s, scene=s.scene._replace(world=bare)), timed=False).verdict == "wrong"
    assert recognisers.landfix(dataclasses.replace(s, target="nobody"), timed=False).verdict == "silent"


def test_the_thesis_method_is_judged_by_the_position_it_reports() -> None:
    s = views.draw("accuracy", "painted", 0, 23)
    assert recognisers.thesis(s, timed=False).verdict == "recognised"
    assert recognisers.thesis(dataclasses.replace(s, p_n=s.p_n + np.array([5.0, 0.0, 0.0])), timed=False).verdict == "wrong"


def test_sift_and_flann_find_the_position_by_its_ground() -> None:
    s = sample()
    checked = recognisers.sift_points(s.left)
    assert len(checked.points) >= 500
    assert s.reference is not None
    found = recognisers.sift_and_flann(s, checked, surroundings=True)
    assert found.verdict == "recognised"
    assert found.error_m is not None
    assert found.error_m < 2.0
    elsewhere = dataclasses.replace(s.reference, centre_px=s.reference.centre_px + 60.0)
    assert recognisers.sift_and_flann(dataclasses.replace(s, reference=elsewhere), checked, True).verdict == "wrong"
    strange = dataclasses.replace(s, reference=sample(number=2).reference)
    assert recognisers.sift_and_flann(strange, checked, True).verdict == "silent"
    assert recognisers.sift_and_flann(dataclasses.replace(s, reference=None), checked, True).verdict == "silent"


@pytest.mark.long
def test_sift_and_flann_are_at_their_best(landfix_data: Path) -> None:
    """A box half hidden in a scene, a wall seen askew, a street in other light are found; a box is not found on the wall."""
    folder = landfix_data / "images/opencv_feature_pairs"
    pairs = [("box.png", "box_in_scene.png"), ("graf1.png", "graf3.png"), ("leuvenA.jpg", "leuvenB.jpg")]
    checked = {name: recognisers.sift_points(np.asarray(cv2.imread(str(folder / name)))) for pair in pairs for name in pair}
    for reference, image in pairs:
        assert recognisers.homography(checked[reference], checked[image]) is not None
    assert recognisers.homography(checked["box.png"], checked["graf1.png"]) is None


def test_a_row_counts_verdicts() -> None:
    verdicts: tuple[recognisers.Verdict, ...] = ("recognised", "wrong", "silent", "recognised")
    answers = [recognisers.Answer(v, 10.0 * k, float(k), pair=1 + k // 2) for k, v in enumerate(verdicts)]
    trials = [Trial("size", "pale", k, 1.0, 900, 0, {"landfix": a}) for k, a in enumerate(answers)]
    counted = row("size", "pale", "landfix", trials, pairs=3)
    assert (counted.samples, counted.recognised, counted.by_pair, counted.wrong) == (4, 2, [1, 2, 2], 1)
    assert counted.error_m_p50 == 1.5
    assert counted.wrong_below == pytest.approx(0.7514, abs=1e-3)


def test_the_command() -> None:
    options = ["--samples", "1", "--experiment", "accuracy", "--roof", "painted", "--pairs", "3", "--jobs", "1"]
    result = CliRunner().invoke(app, ["bench", "recognition", *options, "--json"])
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert [r["method"] for r in found["rows"]] == list(recognisers.METHODS)
    assert found["key_points_least"] >= 500
    assert [len(r["by_pair"]) for r in found["rows"]] == [found["pairs"]] * 4 == [3] * 4
    assert all(r["by_pair"][-1] == r["recognised"] for r in found["rows"])


@pytest.mark.long
@pytest.mark.parametrize(("summits", "verdict"), [(20, "recognised"), (1, "silent")])
def test_the_position_by_cut_roofs_is_not_the_best_one_of_the_reduced_image(summits: int, verdict: str) -> None:
    c = PipelineConfig()
    coarse = msgspec.structs.replace(c.predict.coarse, summits=summits)
    config = msgspec.structs.replace(c, predict=msgspec.structs.replace(c.predict, coarse=coarse))
    assert recognisers.landfix(views.draw("partial", "pale", 7, 11), config, timed=False).verdict == verdict


def test_names_that_are_not_known() -> None:
    result = CliRunner().invoke(app, ["bench", "recognition", "--experiment", "speed"])
    assert result.exit_code == 2
    assert "accuracy, size, partial, description" in result.stderr


@pytest.mark.long
def test_roofs_are_not_found_on_the_shadows_that_they_cast() -> None:
    """Shadows have the roofs' shapes, all at one distance the same way, in one image as in the next."""
    assert recognisers.landfix(views.draw("description", "pale", 402, 0), timed=False).verdict == "recognised"


@long.parametrize(("roof", "seed", "number"), [("painted", 621, 47), ("pale", 722, 34)])
def test_a_roof_of_which_a_tower_hides_half_is_named_where_the_rest_leaves_no_doubt(
    monkeypatch: pytest.MonkeyPatch, roof: views.Roof, seed: int, number: int
) -> None:
    hidden = views.draw("partial", roof, seed, number)
    assert hidden.seen < 0.5
    assert recognisers.landfix(hidden, timed=False).verdict == "recognised"
    monkeypatch.setattr(fit, "_SURE_ANYHOW", math.inf)
    strict = PipelineConfig(predict=PredictConfig(verify=VerifyConfig(hidden_found=0.5)))
    assert recognisers.landfix(hidden, strict, timed=False).verdict == "silent"


@pytest.mark.long
def test_a_position_behind_the_twentieth_summit_is_found() -> None:
    """Pale roofs of which half is in view: the most reduced image shows more edges elsewhere."""
    sample, few = views.draw("partial", "pale", 722, 95), PredictConfig(coarse=CoarseConfig(summits=20, peaks=5))
    assert recognisers.landfix(sample, timed=False).verdict == "recognised"
    assert recognisers.landfix(sample, PipelineConfig(predict=few), timed=False).verdict == "silent"


@pytest.mark.long
def test_a_position_with_more_votes_that_leads_to_the_same_fit_is_no_other_position(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = views.draw("partial", "pale", 741, 71)
    assert recognisers.landfix(sample, timed=False).verdict == "recognised"
    monkeypatch.setattr(verify, "same_position", lambda *_: False)
    assert recognisers.landfix(sample, timed=False).verdict == "silent"


@pytest.mark.long
def test_the_thesis_is_asked_for_a_landmark_however_far_the_view_reaches() -> None:
    """A prior 70 m aside: the landmark asked for is not among those within 50 m of it."""
    sample = views.draw("accuracy", "painted", 3, 0)
    aside = dataclasses.replace(sample.prior, p_n=sample.prior.p_n + np.array([70.0, 0.0, 0.0]))
    assert recognisers.thesis(dataclasses.replace(sample, prior=aside), timed=False).verdict == "recognised"
