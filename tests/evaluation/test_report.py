import base64
import re
from html.parser import HTMLParser

import pytest

from longreach.evaluation.report import report_html
from longreach.evaluation.tables import metric, metric_table

PNG = b"\x89PNG\r\n\x1a\n picture"
NASTY = '<script>alert("1")</script> & more'
VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Collect tags with their attributes, and check that they close in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def text():
    return report_html(
        NASTY,
        f"{NASTY}\n\nA second paragraph.",
        metric_table({NASTY: {"ate_rmse": metric(0.5, "m")}}),
        {"paths": PNG, NASTY: PNG},
        remarks=[NASTY],
        config_yaml=f"key: {NASTY}\n",
    )


def test_the_page_is_well_formed_and_in_one_piece(text):
    page = Page(text)
    assert page.open == []
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}
    assert all(
        value.startswith("data:") for _, attrs in page.tags for k, value in attrs.items() if k in ("src", "href")
    )
    assert not re.search(r"https?:|url\(|@import", text)


def test_what_did_not_reach_its_end_comes_before_the_title():
    text = report_html("Run", "What it is.", metric_table({}), {}, failures=[f"closed did not: {NASTY}"])
    assert Page(text).open == []
    body = text.split("<body>")[1]
    assert body.index("closed did not: &lt;script&gt;") < body.index("<h1>")


def test_all_text_is_escaped(text):
    assert "<script" not in text
    assert text.count("&lt;script&gt;alert(") >= 6


def test_the_pictures_are_inside(text):
    images = [attrs for tag, attrs in Page(text).tags if tag == "img"]
    assert len(images) == 2
    assert all(base64.b64decode(image["src"].split(",")[1]) == PNG for image in images)
    assert all(image["alt"] for image in images)


def test_results_remarks_and_configuration_are_shown(text):
    for part in (
        "Results",
        "Figures",
        "Remarks",
        "Configuration that ran",
        "A second paragraph.",
        "0.5000",
        "<details>",
    ):
        assert part in text


def test_without_a_reference_the_page_says_so():
    text = report_html("Run", "What it is.", metric_table({}), {})
    assert "no reference" in text
    assert "Remarks" not in text
    assert Page(text).open == []
