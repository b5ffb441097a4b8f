"""The report in headless Chromium: nothing overflows, nothing complains, everything can be reached."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.browser import BROWSER, MISSING
from tests.worlds.runs import MODELS, TRACKS, write_report, write_runs

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--allow-file-access-from-files",
    "--enable-logging=stderr",
    "--virtual-time-budget=20000",
]
WIDTHS = (1280, 1100, 820, 390)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BROWSER, reason=MISSING),
]

# Looks at the page in a frame of the wanted width, as windows have a least width.
PROBE = """<!doctype html><meta charset="utf-8"><body style="margin:0">
<iframe id="page" src="report.html" style="border:0;width:WIDTHpx;height:900px"></iframe><pre id="found"></pre><script>
const frame = document.getElementById("page");
const problems = [];
frame.addEventListener("load", async () => {
  const page = frame.contentDocument, view = frame.contentWindow;
  view.addEventListener("error", (event) => problems.push(`error: ${event.message}`));
  const visible = (element) => element.getClientRects().length > 0;
  const choose = (id, value) => {
    const select = page.getElementById(id);
    select.value = value;
    select.dispatchEvent(new view.Event("change", { bubbles: true }));
  };
  const check = async (where) => {
    const root = page.documentElement;
    if (root.scrollWidth > root.clientWidth) problems.push(`${where}: ${root.scrollWidth} of ${root.clientWidth} px`);
    for (const element of page.querySelectorAll("body *")) {
      if (element.closest(".scroll, svg, .skip, thead, select, .window") || !visible(element)) continue;
      const right = element.getBoundingClientRect().right;
      if (right > root.clientWidth + 1) problems.push(`${where}: ${element.outerHTML.slice(0, 80)} ends at ${right}`);
    }
    for (const image of page.querySelectorAll("img")) {
      if (!visible(image)) continue;
      for (let tries = 0; !image.complete && tries < 100; tries++) await new Promise((go) => setTimeout(go, 20));
      if (!image.naturalWidth) problems.push(`${where}: picture ${image.alt} is broken`);
    }
    for (const element of page.querySelectorAll("a, select, summary, [tabindex]")) {
      if (!visible(element)) continue;
      element.focus();
      if (page.activeElement !== element) problems.push(`${where}: no focus on ${element.outerHTML.slice(0, 80)}`);
      const style = view.getComputedStyle(element);
      if (style.outlineStyle === "none") problems.push(`${where}: no outline on ${element.outerHTML.slice(0, 80)}`);
    }
    const articles = [...page.querySelectorAll("article")].filter(visible);
    if (articles.length !== 1) problems.push(`${where}: ${articles.length} tracks are shown`);
  };
  const seen = {};
  for (const track of [...page.getElementById("track").options].map((option) => option.value)) {
    choose("track", track);
    for (const details of page.querySelectorAll("details")) details.open = true;
    const places = [...page.getElementById("a").options].filter((option) => !option.disabled);
    for (const [a, b] of [[0, 1], [1, 0], [2, 2]]) {
      choose("a", places[a].value);
      choose("b", places[b].value);
      await check(`${track}, ${places[a].text} and ${places[b].text}`);
      const article = [...page.querySelectorAll("article")].find(visible);
      seen[`${track} ${a}${b}`] = {
        title: article.querySelector("h2").textContent,
        versus: article.querySelector(".versus").textContent,
        worst: article.querySelectorAll(".worst .card").length,
        apart: article.querySelectorAll(".apart .card").length,
        clips: article.querySelectorAll(".clips .clip").length,
        preview: [...article.querySelectorAll(".previews .label")].map((label) => label.textContent),
        moving: [...article.querySelectorAll(".previews img")].map((img) => view.getComputedStyle(img).animationName),
        first: article.querySelector(".previews img").getBoundingClientRect().bottom + view.scrollY,
        hash: view.location.hash,
      };
    }
  }
  const board = [...page.querySelectorAll(".board")].find(visible);
  for (const name of board.querySelectorAll(".name")) name.textContent = "obpose-contact-pretrained-density";
  const beyond = board.getBoundingClientRect().right - board.parentElement.getBoundingClientRect().right;
  if (beyond > 1) problems.push(`long names: the leaderboard is ${beyond} px wider than its column`);
  const background = view.getComputedStyle(page.body).backgroundColor;
  document.getElementById("found").textContent = JSON.stringify({ problems, seen, background });
});
</script>"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    data = write_runs(folder, crash="splitter")
    write_report(folder / "run", data)
    return folder / "run"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_overflows_nothing_complains_and_everything_takes_the_focus(
    run: Path, tmp_path: Path, width: int, scheme: str
) -> None:
    found, complaints = probe(run, tmp_path, width, scheme)
    assert not complaints
    assert found["problems"] == []
    red = int(found["background"].split("(")[1].split(",")[0])
    assert (red > 127) == (scheme == "light")


def test_choices_change_what_is_shown(run: Path, tmp_path: Path) -> None:
    found, _ = probe(run, tmp_path, 1400, "light")
    seen = found["seen"]
    for track in TRACKS:
        first, swapped, same = (seen[f"{track} {pair}"] for pair in ("01", "10", "22"))
        assert first["title"].startswith(track)
        assert first["worst"] > 0
        assert first["apart"] > 0
        assert same["apart"] == 0
        assert first["versus"].split(" [")[0] != swapped["versus"].split(" [")[0]
        assert first["clips"] == 4 * (3 + len(MODELS) - 1)
        assert first["preview"][:2] == ["RGB", "ground truth"]
        assert sorted(first["preview"]) == sorted(swapped["preview"])
        assert set(first["moving"]) == {"play"}
        assert first["first"] < 800
        assert f"track={track}" in first["hash"]


def test_a_link_to_a_choice_shows_it(run: Path, tmp_path: Path) -> None:
    page = dump(f"{(run / 'report.html').as_uri()}#track=static&a=merger&b=one-cluster", tmp_path, "light").stdout
    assert 'data-track="moving"' in page
    hidden = [part.split(">")[0] for part in page.split("<article ")[1:] if " hidden" in part.split(">")[0]]
    assert len(hidden) == len(TRACKS) - 1
    assert 'data-track="moving"' in hidden[0]
    assert "merger minus one-cluster" in page


def probe(run: Path, profile: Path, width: int, scheme: str) -> tuple[dict[str, Any], list[str]]:
    """Findings of the probe, and lines of the console."""
    (run / "probe.html").write_text(PROBE.replace("WIDTH", str(width)), encoding="utf-8")
    result = dump((run / "probe.html").as_uri(), profile, scheme)
    text = result.stdout.split('<pre id="found">')[1].split("</pre>")[0]
    for name, character in (("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")):
        text = text.replace(name, character)
    return json.loads(text), [line for line in result.stderr.splitlines() if "CONSOLE" in line]


def dump(address: str, profile: Path, scheme: str) -> subprocess.CompletedProcess[str]:
    """The page after its scripts ran."""
    setting = f"--blink-settings=preferredColorScheme={int(scheme == 'light')}"
    command = [BROWSER, *FLAGS, setting, f"--user-data-dir={profile / 'profile'}", "--window-size=1500,1000"]
    return subprocess.run([*command, "--dump-dom", address], capture_output=True, text=True, check=True, timeout=120)
