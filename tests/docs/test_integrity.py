from docs.draw_integrity import OUT, drawn
from estimator.integrity.config import IntegrityConfig


def test_the_fault_tree_has_the_rates_of_the_defaults() -> None:
    assert OUT.read_text(encoding="utf-8") == drawn(IntegrityConfig()), "python -m docs.draw_integrity"
