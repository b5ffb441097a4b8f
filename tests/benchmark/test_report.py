"""The report as a file: whole, self-contained, true to the leaderboard, and honest about what is missing."""

import csv
import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from benchmark import report
from benchmark.ranking import leaderboard
from benchmark.results.reconstructions import save_reconstruction
from benchmark.results.run_folder import load_runs, save_row
from tests.chosen_scores import run_row, save_run, scene_table
from tests.worlds.runs import MODELS, TRACKS, write_report, write_runs

HOSTILE = "<script>alert(1)<&script>'\""
VOID = {"meta", "link", "img", "br", "input"}


class Page(HTMLParser):
    """Reads a page, and complains about tags that do not match."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.rows: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] in ("script", "style"):
            return
        self.text.append(data)
        if "tr" in self._open:
            self.rows[-1] += f"{data} "

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    models = {**MODELS, HOSTILE: dataclasses.replace(MODELS["merger"], kind="predictions")}
    data = write_runs(folder, models=models, crash="splitter")
    leaderboard.write(folder / "run")
    write_report(folder / "run", data)
    return folder


@pytest.fixture(scope="module")
def text(folder: Path) -> str:
    return (folder / "run/report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_the_page_refers_to_nothing_outside(text: str, page: Page) -> None:
    assert "://" not in text
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket", text)
    for _, attributes in page.tags:
        for name in ("src", "href", "action", "data", "poster", "srcset"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))


def test_models_tracks_and_seeds_are_counted(page: Page, tmp_path: Path) -> None:
    words = " ".join(page.text)
    assert "6 models on 2 tracks" in words
    assert "here models have 2 seeds." in words
    save_run(tmp_path, run_row(n_scenes=1), scene_table({"ari_fg": [0.5]}))
    write_report(tmp_path, {})
    words = " ".join(Page((tmp_path / "report.html").read_text(encoding="utf-8")).text)
    assert "1 model on 1 track" in words
    assert "1 test scene;" in words
    assert "here models have 1 seed." in words


def test_the_first_lines_name_project_dataset_command_and_date(page: Page) -> None:
    first = " ".join(" ".join(page.text[: page.text.index("Track ")]).split())
    for words in ("ObPose", *TRACKS, "obpose-bench --model <b>", "2026-01-02", "commit 01234567"):
        assert words in first


def test_learned_models_are_ranked_among_themselves_and_baselines_apart(page: Page) -> None:
    rows = [" ".join(row.split()) for row in page.rows]
    first = rows[rows.index("Learned models") :]
    ranks = {words[1]: words[0] for row in first[:7] if (words := row.split())[0].isdigit()}
    assert ranks["noisy-learner"] == "1"
    assert ranks["merger"] == "1"
    assert "Training-free baselines" in first
    assert any(row.startswith("one-cluster") for row in first)


def test_what_occurs_in_the_table_is_explained_below_it(page: Page) -> None:
    words = " ".join(" ".join(page.text).split())
    assert "Letters behind a score: Models that share a letter" in words
    assert "† uses ground-truth labels" in words
    assert "§ pretrained" not in words
    titles = {attributes.get("title") for attributes in page.all("abbr")}
    assert any("uses ground-truth labels" in (title or "") for title in titles)


def test_clips_of_all_models_are_there_to_be_played(text: str) -> None:
    for gallery in json.loads(script(text, "facts"))["galleries"].values():
        for clip in gallery["clips"]:
            assert clip["count"] in (5, 3)
            names = [layer.get("name") for layer in clip["layers"]]
            assert names[:3] == ["RGB", "ground truth", "depth"]
            assert len(clip["layers"]) == 3 + len(MODELS)


def test_clips_are_of_scenes_with_reconstructions_if_there_are_any(folder: Path, tmp_path: Path, text: str) -> None:
    old = json.loads(script(text, "facts"))["galleries"]["0"]
    assert "with reconstructions" not in old["choice"]
    assert not [layer for clip in old["clips"] for layer in clip["layers"] if layer.get("part") == "reconstruction"]
    shutil.copytree(folder / "run", tmp_path / "run")
    (row, *_) = (r for r in load_runs(tmp_path / "run") if (r.key.track, r.key.model) == ("moving", "merger"))
    for scene in (0, 5):
        save_reconstruction(tmp_path / "run", row, scene, np.full((5, 36, 48, 3), 10 * scene, np.uint8))
    write_report(tmp_path / "run", {track: folder / track for track in TRACKS})
    new = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    gallery = json.loads(script(new, "facts"))["galleries"]["0"]
    assert gallery["choice"] == "Test scenes with reconstructions: of median difficulty, then the hardest."
    assert sorted(clip["scene"] for clip in gallery["clips"]) == [0, 5]
    for clip in gallery["clips"]:
        (layer,) = (layer for layer in clip["layers"] if layer.get("part") == "reconstruction")
        assert json.loads(script(new, "facts"))["models"][layer["model"]] == "merger"


def test_names_of_models_cannot_become_code(text: str, page: Page) -> None:
    assert len(page.all("script")) == 3
    assert "<script>alert" not in text
    assert HOSTILE in " ".join(page.text)


def test_numbers_are_those_of_the_leaderboard(folder: Path, page: Page) -> None:
    with (folder / "run/leaderboard.csv").open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["model"] in MODELS]
    assert len(lines) == len(MODELS) * len(TRACKS)
    for line in lines:
        rows = [row for row in page.rows if row.split()[:1] == [line["model"]] or row.split()[1:2] == [line["model"]]]
        for metric in ("msc_fg", "ari_fg"):
            if line[f"{metric}_mean"] in ("", "nan"):
                continue
            values = [float(line[f"{metric}_{part}"]) for part in ("mean", "ci_low", "ci_high")]
            mean, low, high = (f"{value:z.3f}".replace("-", "−") for value in values)
            assert any(mean in row and f"[{low}, {high}]" in row for row in rows), (line["model"], metric)


def test_segmentations_that_share_a_training_say_where_their_curve_is(tmp_path: Path) -> None:
    curve = [{"step": 0.0, "loss": 2.0}, {"step": 1.0, "loss": 1.0}]
    save_run(tmp_path, run_row("net", n_scenes=1, learning_curve=curve), scene_table({"ari_fg": [0.5]}))
    save_run(tmp_path, run_row("net-att", n_scenes=1), scene_table({"ari_fg": [0.5]}))
    write_report(tmp_path, {})
    words = " ".join(Page((tmp_path / "report.html").read_text(encoding="utf-8")).text)
    assert "Without a curve of their own: net-att." in words
    assert "No floor was scored on moving" in words


def test_scores_of_validation_clips_stand_over_minutes_and_losses_over_steps(tmp_path: Path) -> None:
    curve = [{"step": 3.0, "seconds": 60.0, "loss": 2.0, "ari_fg": 0.1}, {"step": 9.0, "seconds": 180.0, "ari_fg": 0.3}]
    save_run(tmp_path, run_row("net", n_scenes=1, learning_curve=curve), scene_table({"ari_fg": [0.5]}))
    write_report(tmp_path, {})
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert 'aria-label="ARI-FG on validation clips by minutes' in text
    assert "net: 0.300 at minute 3<" in text
    assert 'aria-label="loss by step' in text
    assert "net: 2.000 at step 3<" in text


def test_the_papers_figures_stand_apart(page: Page) -> None:
    words = " ".join(page.text)
    assert "In the paper: other data, not comparable" in words
    assert "ObPose loc. & rot." in words


def test_links_within_the_page_lead_somewhere(page: Page) -> None:
    places = {attributes.get(name) for _, attributes in page.tags for name in ("id", "data-id")}
    assert {(attributes["href"] or "")[1:] for attributes in page.all("a")} <= places


@pytest.mark.slow
def test_another_process_gives_the_same_bytes(folder: Path, text: str) -> None:
    code = "import sys; from pathlib import Path; from tests.worlds.runs import TRACKS, write_report; "
    code += "f = Path(sys.argv[1]); write_report(f / 'run', {track: f / track for track in TRACKS})"
    root = Path(report.__file__).parents[2]
    environment = {**os.environ, "PYTHONHASHSEED": "7", "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, env=environment, cwd=root)
    assert (folder / "run/report.html").read_text(encoding="utf-8") == text


@pytest.mark.parametrize("lost", ["labels", "data", "the right data"])
def test_what_is_missing_is_said(folder: Path, tmp_path: Path, lost: str) -> None:
    run = tmp_path / "run"
    shutil.copytree(folder / "run", run, ignore=shutil.ignore_patterns("labels" if lost == "labels" else "none"))
    other = {"moving": folder / "static", "static": folder / "moving"}
    data = {"labels": {track: folder / track for track in TRACKS}, "data": {}, "the right data": other}[lost]
    write_report(run, data)
    text = (run / "report.html").read_text(encoding="utf-8")
    reason = {
        "labels": "The run folder holds no label maps of this track.",
        "data": "The dataset is not on this machine.",
        "the right data": "The dataset is not on this machine.",
    }[lost]
    assert text.count(reason) == 5 * len(TRACKS)
    assert json.loads(script(text, "pictures")) == []
    Page(text)


def test_models_fitted_elsewhere_stand_in_a_table_of_their_own(tmp_path: Path) -> None:
    data = write_runs(tmp_path, scenes=2, seeds=1, models={"merger": MODELS["merger"]})
    for row in load_runs(tmp_path / "run"):
        if row.key.track == "static":
            moved = dataclasses.replace(row, key=dataclasses.replace(row.key, fit_track="moving"))
            shutil.copy(tmp_path / f"run/scenes/{row.key.name}.csv", tmp_path / f"run/scenes/{moved.key.name}.csv")
            save_row(tmp_path / "run", moved)
    write_report(tmp_path / "run", data)
    page = Page((tmp_path / "run/report.html").read_text(encoding="utf-8"))
    fields = [(article.get("data-track"), article.get("data-fit")) for article in page.all("article")]
    assert sorted(fields) == [("moving", "the track itself"), ("static", "moving"), ("static", "the track itself")]


def test_datasets_that_share_a_name_are_kept_apart(tmp_path: Path) -> None:
    data = write_runs(tmp_path, scenes=2, seeds=1, models={"merger": MODELS["merger"]})
    for row in load_runs(tmp_path / "run"):
        if row.key.track == "static":
            renamed = dataclasses.replace(row, key=dataclasses.replace(row.key, track="moving", model="splitter"))
            shutil.copy(tmp_path / f"run/scenes/{row.key.name}.csv", tmp_path / f"run/scenes/{renamed.key.name}.csv")
            save_row(tmp_path / "run", renamed)
    write_report(tmp_path / "run", data)
    page = Page((tmp_path / "run/report.html").read_text(encoding="utf-8"))
    tracks = [article.get("data-track") or "" for article in page.all("article")]
    assert len(set(tracks)) == len(tracks) == 3
    assert all(track.startswith(("moving", "static")) for track in tracks)


def test_a_page_that_grows_too_large_has_fewer_pictures(folder: Path, tmp_path: Path, text: str) -> None:
    shutil.copytree(folder / "run", tmp_path / "run")
    write_report(tmp_path / "run", {track: folder / track for track in TRACKS}, largest=1)
    frugal = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    count = len(json.loads(script(frugal, "pictures")))
    assert 0 < count < len(json.loads(script(text, "pictures")))


def script(text: str, name: str) -> str:
    start = text.index(">", text.index(f'id="{name}"')) + 1
    return text[start : text.index("</script>", start)]
