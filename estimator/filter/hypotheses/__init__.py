"""Filters side by side for undecided questions. May import estimator.filter.eskf and what is below it."""

from estimator.filter.hypotheses.hypotheses import Hypotheses, Verdict
from estimator.filter.hypotheses.hypothesis import SENSORS, Doubt, Hypothesis
from estimator.filter.hypotheses.innovation import MOST_OF_A_KIND, clone_of, innovation
from estimator.filter.hypotheses.mixture import ln_sum

__all__ = ["MOST_OF_A_KIND", "SENSORS", "Doubt", "Hypotheses", "Hypothesis", "Verdict", "clone_of", "innovation", "ln_sum"]
