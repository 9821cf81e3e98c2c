"""The figures in "Why to trust it" of the README are those of the documents that it links to, each in its place."""

import re

import pytest
from shared import PROJECT

README = PROJECT / "README.md"
# a whole number with or without commas, or one with a decimal point; not a part of a word or of a version
FIGURE = re.compile(r"(?<![\w.,])\d[\d,]*(?:\.\d+)?(?![\w.]*\w)")


def section(link: str) -> str:
    """The part of a document that a link leads to, its smaller headings included."""
    name, _, anchor = link.partition("#")
    lines = (PROJECT / name).read_text().splitlines()
    heads = [(number, line) for number, line in enumerate(lines) if re.match(r"#+ ", line)]
    [(begin, head)] = [(number, line) for number, line in heads if re.sub(r"[^\w\- ]", "", line.lower()).strip().replace(" ", "-") == anchor]
    level = head.index(" ")
    end = next((number for number, line in heads if number > begin and line.index(" ") <= level), len(lines))
    return "\n".join(lines[begin:end])


def row(text: str, first: str) -> list[str]:
    """The cells of the only row of a table with this first cell."""
    [found] = [line for line in text.splitlines() if re.match(rf"\| *{re.escape(first)} *\|", line)]
    return [cell.strip() for cell in found.strip("|").split("|")]


def number(text: str) -> float:
    return float(text.replace(",", ""))


def figures(text: str) -> list[float]:
    return [number(found) for found in FIGURE.findall(text)]


def claims() -> dict[str, str]:
    """What the README says before each of its links in this section, by the link; what follows the last one is under ""."""
    text = section("README.md#why-to-trust-it").split("\n", 1)[1]
    said, begin = {}, 0
    for link in re.finditer(r"\[[^\]]*\]\(([^)]+)\)", text):
        said[link[1]] = text[begin:link.start()]
        begin = link.end()
    said[""] = text[begin:]
    return said


def faults(text: str) -> list[float]:
    """Injected; had to close; closed; the others; how many the short form has."""
    _, injected, as_they_must, closed, *_ = row(text, "**all**")
    did, had_to = figures(closed)
    others = number(injected) - had_to
    # the README says that every other one ended as required
    assert number(as_they_must) - did == others, "a fault that need not close did not end as it must"
    [short] = re.findall(r"short form.*?some (\d+) cases", text, re.S)
    return [number(injected), had_to, did, others, number(short)]


def side_by_side(text: str) -> list[float]:
    """Faults; closed at the end: Starmesh of all, and the predecessor; went on: Starmesh of all, and the predecessor."""
    cells = row(text, "**all**")
    (ours, all_of_them), (theirs, _) = figures(cells[4]), figures(cells[5])
    (ours_on, _), (theirs_on, _) = figures(cells[6]), figures(cells[7])
    listed = [line for line in text.splitlines() if re.match(r"\| .* \| (yes|\*\*no\*\*) \| (yes|\*\*no\*\*) \|", line)]
    assert len(listed) == all_of_them and sum("| yes | yes |" in line for line in listed) == theirs, "the sum is not that of the rows"
    return [all_of_them, ours, theirs, ours_on, theirs_on]


def solution(text: str) -> list[float]:
    """Width and height of the frame; median seconds until its solution is on the bus."""
    head = next(line for line in text.splitlines() if re.match(r"\| work \| \d+ x \d+", line))
    width, height = figures(head)[:2]
    median_ms = figures(row(text, "WCS and quality on the bus")[1])[0]
    return [width, height, round(median_ms / 1000, 2)]


def random_lists(text: str) -> list[float]:
    """Star lists that the solver was given in vain."""
    [line] = [line for line in text.splitlines() if re.match(r"\| [\d,]+ random star lists \| none accepted \|", line)]
    return figures(line)


def permit(text: str) -> list[float]:
    """The age of a permit at which the dome closes, s."""
    return [number(re.search(r"`dome\.permit_valid_s` \| s, (\d+)", text)[1])]


# where the README reads its figures, in the order in which it says them
HELD = {
    "docs/reliability.md#the-proof": faults,
    "docs/reliability.md#the-predecessor": side_by_side,
    "docs/imaging.md#time": solution,
    "docs/imaging.md#solving": random_lists,
}


@pytest.mark.parametrize("link", HELD)
def test_the_figures_are_those_of_the_document(link):
    assert figures(claims()[link]) == HELD[link](section(link))


def test_no_other_figure_is_said():
    """A figure before a link that is not held above is one that nobody looks at; of the way it works there is one."""
    said = claims()
    assert set(HELD) <= set(said)
    others = " ".join(text for link, text in said.items() if link not in HELD)
    assert figures(others) == permit((PROJECT / "docs/operator/config.md").read_text())
