"""Film strips of a stride."""

from pathlib import Path

import pytest

from benchmarks.paper import film_strip


@pytest.mark.usefixtures("pictures")
def test_a_film_strip_is_drawn(tmp_path: Path) -> None:
    small = {"frames": 2, "settle": 0.0, "width": 80, "height": 100}
    film_strip.main(film_strip.Config(out=tmp_path / "strip.png", **small))
    assert (tmp_path / "strip.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("made", "falling")
def test_film_strip_closes_after_fall(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="the robot fell"):
        film_strip.main(film_strip.Config(out=tmp_path / "strip.png"))
