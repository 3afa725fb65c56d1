"""A file that is empty, cut, damaged or of another program is named by the first sentence of an import."""

import numpy as np
import pytest

from benchmarks.attacks import seeds
from tests.logs.importers.file_faults import FILE_FAULTS, said_of


@pytest.mark.parametrize("name", FILE_FAULTS)
def test_the_first_sentence_names_what_is_wrong_with_the_file(name: str) -> None:
    fault = FILE_FAULTS[name]
    if not seeds.of(fault.seed):
        pytest.skip(f"LANDFIX_DATA holds no log of kind {fault.seed}")
    said = said_of(fault, np.random.default_rng(1))
    assert any(word in said for word in fault.words), said
