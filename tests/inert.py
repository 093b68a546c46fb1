"""Whether a page or a Markdown text would run, fetch or lead to anything."""

from html.parser import HTMLParser

from markdown_it import MarkdownIt  # of rich

HOSTILE = (
    "\"'></td><script>alert(1)</script><img src=http://e.example/x onerror=y>[z](javascript:q)"
    "![w](http://e.example/w.png)<http://e.example> [r]: http://e.example $\\frac{$ & `{{ 7 * 7 }}`"
)
HARMLESS = ("#", "data:image/jpeg;base64,", "data:image/png;base64,")
ACTIVE = {"script", "iframe", "object", "embed", "link", "base", "form", "video", "audio", "source"}
LEADING = {"src", "href", "xlink:href", "action", "srcset"}


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.live, self.text = [], []

    def handle_starttag(self, tag, attributes):
        self.live += [tag] if tag in ACTIVE else []
        for name, value in attributes:
            leads = name in LEADING and not value.startswith(HARMLESS)
            if leads or name.startswith("on") or (name == "style" and "url(" in value.replace("url(#", "")):
                self.live.append((tag, name, value))

    def handle_data(self, data):
        self.text.append(data)


def read_page(html):
    """What of it would act, and all text that a reader sees."""
    page = _Page()
    page.feed(html)
    return page.live, "".join(page.text)


def read_markdown(text):
    """The same of Markdown."""
    blocks = MarkdownIt("commonmark").enable("table").parse(text)
    tokens = [t for block in blocks for t in (block, *(block.children or ()))]
    live = [t.type for t in tokens if t.type in ("image", "link_open", "html_inline", "html_block")]
    shown = ("text", "text_special", "fence", "code_inline")
    return live, "".join(t.content for t in tokens if t.type in shown)
