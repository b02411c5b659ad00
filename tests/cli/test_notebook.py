"""HTML for notebooks shows texts as they are, whoever wrote them."""

from html.parser import HTMLParser

from marl_mm.notebook import html_picture, html_table

NASTY = '<script>alert("x")</script> & \'"><img src=x onerror=alert(1)>'


class Reader(HTMLParser):
    """Tags, attributes and texts, as a browser finds them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def test_a_table_keeps_texts_and_adds_no_other_tags() -> None:
    page = Reader(html_table([("mine", NASTY)], header=("name", NASTY)))
    names = [tag for tag, _ in page.tags]
    assert names == ["table", "tr", "th", "th", "tr", "td", "td"]
    assert page.texts == ["name", NASTY, "mine", NASTY]


def test_a_picture_is_one_tag_whatever_its_text() -> None:
    ((tag, attributes),) = Reader(html_picture(b"\x89PNG", NASTY)).tags
    assert tag == "img" and attributes["alt"] == NASTY
    assert attributes["src"] == "data:image/png;base64,iVBORw=="
