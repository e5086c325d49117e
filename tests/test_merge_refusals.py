"""What merging refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from test_merge import session, written

from kinefilter import clean_session, merge
from kinefilter.characters import InputError
from kinefilter.pipeline.cli import main


def test_what_is_no_list_of_takes_is_refused() -> None:
    (take, *_) = session(4).takes
    merged: tuple[Any, ...] = (merge, clean_session)
    for function in merged:
        for takes in (take, "a.csv", ["a.csv", "b.csv"], None):
            with pytest.raises(InputError, match=r"takes? must be a (list or tu|Take)"):
                function(takes)
    with pytest.raises(InputError, match="the config must be a CleanConfig, got"):
        merged[1]([take, take], {})


_FAR_AWAY = """{"file": "kinefilter calibration", "sensors": [{"source": "a"},
{"lag_seconds": 0, "turn_xyzw": [0, 0, 0, 1], "shift_meters": [1e300, 0, 0]}]}"""


@pytest.mark.parametrize(
    "text", ["", "[]", '{"file": "kinefilter calibration"}', "{", _FAR_AWAY]
)
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "session.json"
    path.write_text(text)
    paths = written(tmp_path, *session(4).takes)
    out = tmp_path / "merged.csv"
    assert main(["merge", *paths, "-o", str(out), "--calibration", str(path)]) == 2
    assert not out.exists()
