"""A report read by the standard library's parser."""

from __future__ import annotations

import json
from html.parser import HTMLParser

VOID = {"meta", "link", "img", "input", "br"}


class Element:
    def __init__(self, tag, attributes, parent):
        self.tag, self.attributes, self.parent = tag, dict(attributes), parent
        self.children, self.texts = [], []

    def text(self):
        return " ".join("".join(self.parts()).split())

    def parts(self):
        for piece in self.texts:
            if isinstance(piece, str):
                yield piece
            else:
                yield from piece.parts()

    def all(self, *tags):
        for child in self.children:
            if not tags or child.tag in tags:
                yield child
            yield from child.all(*tags)


class Page(HTMLParser):
    """The tree of a page; an element that is not closed, or closed twice, is an error."""

    def __init__(self, source):
        super().__init__(convert_charrefs=True)
        self.source = source
        self.root = self.here = Element("", (), None)
        self.feed(source)
        self.close()
        assert self.here is self.root, f"<{self.here.tag}> is not closed"

    def handle_starttag(self, tag, attributes):
        element = Element(tag, attributes, self.here)
        self.here.children.append(element)
        self.here.texts.append(element)
        if tag not in VOID:
            self.here = element

    def handle_endtag(self, tag):
        assert tag == self.here.tag, f"</{tag}> closes <{self.here.tag}>"
        self.here = self.here.parent

    def handle_data(self, data):
        self.here.texts.append(data)

    def all(self, *tags):
        return list(self.root.all(*tags))

    def by_id(self, name):
        (found,) = (element for element in self.root.all() if element.attributes.get("id") == name)
        return found

    def has_id(self, name):
        return any(element.attributes.get("id") == name for element in self.root.all())

    def data(self, name):
        def refuse(constant):
            raise AssertionError(f"{constant} is no JSON")

        return json.loads("".join(self.by_id(name).parts()), parse_constant=refuse)
