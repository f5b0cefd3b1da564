"""One HTML file that needs no other and no network: sections, figures, pictures; the same bytes each time."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
from markdown_it import MarkdownIt
from plotly.graph_objects import Figure
from plotly.offline import get_plotlyjs

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError

JPEG_QUALITY = 82
WIDEST = 1600  # pixels of a picture
_STYLE = """
:root { color-scheme: light; --line: #d8dde3; --soft: #5b6572; --link: #0b57a4; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 74rem; padding: 0 1rem 4rem; color: #1b2027; }
body { font: 1rem/1.55 system-ui, sans-serif; }
h1 { font-size: 1.7rem; margin: 1.5rem 0 .3rem; } h2 { font-size: 1.3rem; margin: 2.5rem 0 .4rem; }
p { max-width: 50rem; } .note { color: var(--soft); font-size: .92rem; }
a { color: var(--link); } a:focus-visible, summary:focus-visible, .wide:focus-visible { outline: 3px solid #f0a202; }
nav ul { display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; padding: 0; list-style: none; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid var(--line); padding: .25rem .6rem; text-align: left; white-space: nowrap; }
img { max-width: 100%; height: auto; } figure { margin: 1rem 0; } figcaption { color: var(--soft); font-size: .92rem; }
@media print {
  nav, .modebar { display: none; }
  body { max-width: none; } h2 { break-after: avoid; } figure { break-inside: avoid; }
}
"""


@dataclass(frozen=True)
class Section:
    """A heading with what stands under it: HTML."""

    title: str
    body: str

    @property
    def anchor(self) -> str:
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


def write(path: Path, title: str, lead: str, sections: Sequence[Section]) -> None:
    """Write the page; `lead` is HTML. plotly.js is in it once."""
    links = "".join(f'<li><a href="#{section.anchor}">{html.escape(section.title)}</a></li>' for section in sections)
    body = "\n".join(
        f'<section id="{section.anchor}">\n<h2>{html.escape(section.title)}</h2>\n{section.body}\n</section>'
        for section in sections
    )
    text = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n<script>{get_plotlyjs()}</script>\n</head>\n"
        f'<body>\n<header>\n<h1>{html.escape(title)}</h1>\n{lead}\n<nav aria-label="Sections"><ul>{links}</ul></nav>\n'
        f"</header>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )
    with replacing(path) as tmp:
        tmp.write_text(text, encoding="utf-8")


def paragraph(text: str, *, note: bool = False) -> str:
    """Return a paragraph of plain text."""
    return f'<p class="note">{html.escape(text)}</p>' if note else f"<p>{html.escape(text)}</p>"


def markdown(text: str) -> str:
    """Return Markdown with tables as HTML; a table that is wider than the screen scrolls by itself, by keys too."""
    rendered: str = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    return rendered.replace("<table>", '<div class="wide" tabindex="0"><table>').replace("</table>", "</table></div>")


def plot(name: str, figure: Figure, caption: str) -> str:
    """Return a figure as HTML; `name` is that of its element, unique in the page."""
    drawn = figure.to_html(
        full_html=False, include_plotlyjs=False, div_id=name, config={"responsive": True, "displaylogo": False}
    )
    label = html.escape(caption, quote=True)
    return f'<figure role="group" aria-label="{label}">\n{drawn}\n<figcaption>{label}</figcaption>\n</figure>'


def picture(path: Path, caption: str) -> str:
    """Return a picture file as a JPEG in HTML, at most WIDEST pixels wide. Raises InputError if it is damaged."""
    image = cv2.imread(str(path))
    if image is None:
        raise InputError(f"{path} is not a picture: make it again with dvc repro --force --single-item pictures")
    height, width = image.shape[:2]
    if width > WIDEST:
        image = cv2.resize(image, (WIDEST, round(height * WIDEST / width)), interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    data = base64.b64encode(encoded.tobytes()).decode("ascii")
    text = html.escape(caption, quote=True)
    drawn = f'<img loading="lazy" src="data:image/jpeg;base64,{data}" alt="{text}">'
    return f"<figure>{drawn}<figcaption>{text}</figcaption></figure>"
