"""A pytest plugin: every `InputError` in other words, for tests that hold no wording.

The names, values and rarer words of a message stay, the words that make a sentence of them are spelt backwards.
"""

import re

from stillwork.base.checks import InputError

COMMON = """a above all among an another any are at be below beyond both but by can cannot choose does each else every
fill from give has have hold holds in is it its keep last leave least longer make mend most move must name need needs
no not of on one only other out pass pick raise remove run say so some take takes than that the them there this to too
up use used want wants was were what where which with within without write you""".split()
WORDS = re.compile(rf"(?<![\w.'-])(?!^)({'|'.join(COMMON)})(?![\w.'=-])")


def reworded(text: str) -> str:
    return WORDS.sub(lambda word: word[0][::-1], text)


def pytest_configure():
    plain = InputError.__str__
    InputError.__str__ = lambda self: reworded(plain(self))
