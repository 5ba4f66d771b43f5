"""What an alert says. Oracle: the words written out by hand."""

import pytest

from plumbline.alerts.quantities import in_words


@pytest.mark.parametrize(
    ("quantity", "value", "words"),
    [
        ("displacement_horizontal", 0.0613, "61.3 mm"),
        ("acceleration_3d", 1.4761, "1476 mm/s²"),
        ("data_gap", 12.34, "12.3 s"),
    ],
)
def test_values_in_an_alerts_text(quantity: str, value: float, words: str) -> None:
    """What a duty officer reads: millimetres and a unit (written out by hand)."""
    assert in_words(quantity, value) == words
