"""The page as its reader gets it."""

from html.parser import HTMLParser
from pathlib import Path

from missions.trials.shared.page import Chapter, render_page
from missions.trials.shared.trial import TrialFinding, TrialResult, TrialTable

FINDINGS = (
    TrialFinding("pairs < 1 mm & more", "97 %", "95 % to 98 %", "90 %", "≥ 95 %", "met"),
    TrialFinding("time, s", "9.1", goal="≤ 8", verdict="short", note="because of <the lens>"),
    TrialFinding("frames", "350"),
)


class Texts(HTMLParser):
    """Collects the text, and refuses what is not closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.images: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.images.append(dict(attrs)["src"] or "")
        elif tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def read(page: str) -> Texts:
    texts = Texts()
    texts.feed(page)
    assert texts.open == []
    return texts


def chapter(name: str, folder: Path, result: TrialResult | None, error: str = "") -> Chapter:
    return Chapter(
        name,
        f"Title of {name}",
        "Section",
        f"path-handoff trial {name} --seed 3",
        folder,
        12.4,
        result,
        error,
    )


def test_one_trial_fills_its_page(tmp_path: Path) -> None:
    (tmp_path / "errors.png").write_bytes(b"\x89PNG not really")
    noise = TrialTable("Noise", ("what", "sigma"), (("blur", "0.6 px"),), "as <measured>")
    result = TrialResult({}, FINDINGS, noise, (), {"errors.png": "Errors & more"}, ("A note.",))
    page = read(render_page([chapter("static", tmp_path, result)], 1))
    text = "\n".join(page.texts)
    for expected in (
        "Title of static",
        "path-handoff trial static --seed 3",
        "pairs < 1 mm & more",
        "95 % to 98 %",
    ):
        assert expected in text
    for expected in (
        "falls short",
        "because of <the lens>",
        "0.6 px",
        "as <measured>",
        "A note.",
        "Errors & more",
    ):
        assert expected in text
    assert page.images[0].startswith("data:image/png;base64,")


def test_the_page_of_all_begins_with_what_has_a_paper_or_a_goal_beside_it(tmp_path: Path) -> None:
    chapters = [
        chapter("static", tmp_path, TrialResult({}, FINDINGS)),
        chapter("link", tmp_path, None, "Traceback: the socket"),
    ]
    page = render_page(chapters, 2)
    overview = page[: page.index("<h2")]
    assert "falls short" in overview
    assert "failed" in overview
    assert "frames" not in overview
    assert "Traceback: the socket" in "\n".join(read(page).texts)
    assert "Not finished" not in page


def test_a_page_of_less_than_was_asked_for_says_so(tmp_path: Path) -> None:
    page = render_page([chapter("static", tmp_path, TrialResult({}, FINDINGS))], 9)
    assert "1 of 9 trials have run" in "\n".join(read(page).texts)
