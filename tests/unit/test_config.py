"""Settings: what is wrong is said in the error."""

from pathlib import Path

import pytest

from plumbline.config import read_server_settings
from plumbline.errors import ConfigurationError


def test_flags_win_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "plumbline.toml"
    path.write_text('http_port = 8100\ningest_port = 9100\n[[stations]]\nstation = "tower"\n')
    settings = read_server_settings(path, http_port=8200, ingest_port=None)
    assert (settings.http_port, settings.ingest_port) == (8200, 9100)
    assert settings.stations[0].station == "tower"


@pytest.mark.parametrize(
    ("text", "named"),
    [("http_port = 70000", "http_port"), ("htp_port = 1", "htp_port"), ("a = [", "plumbline.toml"),
     ('[[stations]]\nstation = "../etc"', "station"), ('tls_key = "k"', "tls_certificate")],
)  # fmt: skip
def test_a_wrong_setting_is_named(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "plumbline.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=named):
        read_server_settings(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"none\.toml"):
        read_server_settings(tmp_path / "none.toml")
