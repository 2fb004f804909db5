"""Messages are values: code, kind and numbers survive files and processes, and every sentence is written once."""

from __future__ import annotations

import ast
import copy
import json
import math
import pickle
import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from string import Formatter

import pytest
import yaml

from drive_id.common.messages import Message

PACKAGE = Path(__file__).parent.parent / "drive_id"
CATALOGUE = yaml.safe_load((PACKAGE / "common" / "messages.yaml").read_text(encoding="utf-8"))
KINDS = ("error", "warning", "statement", "nothing", "advice")
TEMPLATES = {key: text for kind in KINDS for key, text in CATALOGUE[kind].items()}
FAMILIES = {
    "current_offset", "voltage_offset", "current_gain_mismatch", "current_rotation", "single_sample", "misfit",
    "not_reciprocal", "separation", "left_out",
}  # fmt: skip
"""Codes whose wordings the code puts together."""
COUNTED = (
    "bytes|cells|changes|columns|degrees|entries|files|gaps|messages|pairs|parts|places|points|recordings|requests|results"
    "|rows|runs|samples|unknowns|windows"
)
"""What counts count, where one may be all there is."""
REPORTED = "{reason}"  # of an exception, or of a draft


@cache
def literals() -> set[str]:
    """Return all texts in the code, without those that are documentation."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")]
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {node.value for node in nodes if isinstance(node.value, str) and len(node.value) < 60}


def fields_in(template: str) -> list[tuple[str, str]]:
    fields = [(name, spec or "") for _, name, spec, _ in Formatter().parse(template) if name]
    return sum((fields_in(spec) for _, spec in fields), fields)


def test_a_message_is_its_sentence_and_its_values():
    message = Message("resistance_vague", resistance=0.01, sigma_resistance=0.02)
    assert message == (
        "The resistance, 0.01 ohm, is not significantly different from zero (standard error 0.02 ohm): record at a "
        "lower speed or at several speeds."
    )
    assert (message.code, message.kind) == ("resistance_vague", "warning")
    assert message.values == {"resistance": 0.01, "sigma_resistance": 0.02}


@pytest.mark.parametrize("again", [copy.deepcopy, lambda message: pickle.loads(pickle.dumps(message))])
def test_it_survives_processes(again):
    message = Message("region", share=0.25, i_d=-3.0, i_q=2.0)
    found = again(message)
    assert (found, found.code, found.kind, found.values) == (message, "region", "statement", dict(message.values))


def test_it_survives_files_and_those_of_earlier_versions_hold_sentences():
    message = Message("diverged", remedy="passive_maps")
    found = Message.stored(json.loads(json.dumps(message.tree())))
    assert (found, found.tree()) == (message, message.tree())
    assert Message.stored("A sentence.").tree() == {
        "code": "", "kind": "warning", "sentence": "A sentence.", "values": {}
    }  # fmt: skip
    assert Message("coverage", coverage=0.5, i_max=math.inf).tree()["values"] == {"coverage": 0.5, "i_max": None}


def test_units_and_optional_parts():
    lost = {"topic": "/u", "period": 1e-4, "jitter": 2.5e-6, "gaps": 3, "counted": False}
    assert "by 100 us, " in Message("equally_spaced", **lost)
    assert Message("equally_spaced", **lost).endswith("jitter by 2.5 us rms.")
    assert Message("equally_spaced", missing=9, **lost).endswith(
        "; 9 samples are missing in 3 places, inferred from permanent steps of the stamps."
    )
    assert "rms. Up to 1 sample missing in one place cannot be distinguished" in Message(
        "equally_spaced", unseen=1, **lost
    )
    assert "5 ± 0.11°" not in Message("resolver_offset", value=math.radians(5), sigma=math.radians(0.11))
    assert "5.00 ± 0.11 °" in Message("resolver_offset", value=math.radians(5), sigma=math.radians(0.11))
    of_phase = Message("resistance_of_phase", phase=1, value=1e-3, sigma=1e-4, resistance=2.0)
    assert of_phase.startswith("The resistance of phase b is 0.00100 ± 0.00010 Ω above"), "R = 2 Ω is in Ω"
    rivals = Message("iron_loss_current", value=1.0, sigma=0.1, rivals="flux_lag_4ms,dc_link", several_speeds=True)
    assert rivals.endswith(
        " This is ambiguous: flux that lags the current by 4 ms or a varying DC-link voltage would explain these data "
        "nearly as well; a faster trajectory would distinguish them."
    )
    many = {**rivals.values, "rivals": "flux_lag_4ms,dc_link,iron_loss,flux_lag,link_sag"}
    assert "by 4 ms, a varying DC-link voltage, iron loss or 2 others would" in Message("iron_loss_current", **many)


def test_a_sentence_without_its_values_is_refused():
    with pytest.raises(KeyError, match="gaps lacks a value"):
        Message("gaps", gaps=2)
    with pytest.raises(KeyError, match="resistance_of_phase lacks a value"):
        Message("resistance_of_phase", phase=1, value=1e-3, sigma=1e-4)


@pytest.mark.parametrize("key", TEMPLATES)
def test_each_is_used_and_a_whole_sentence(key):
    """Wordings of one code end the key, and may be put together."""
    texts = literals()
    assert key in texts or key.partition(".")[0] in FAMILIES, f"nothing says {key}"
    text = TEMPLATES[key]
    if text == REPORTED or text.startswith("{"):
        return
    assert text[0].isupper() or text.startswith(("i_max ", "psi_")), text
    assert re.search(r"[.}]$", text), text
    assert "  " not in text


def longest(template: str) -> str:
    """Return the longest wording of a template, a value being one word."""

    def filled(field: re.Match[str]) -> str:
        name, _, spec = field[1].partition(":")
        if spec.startswith("?"):
            return max(spec[1:].partition("//")[::2], key=len)
        return CATALOGUE["clause"].get(name) or "9 " + spec.partition("# ")[2].partition("//")[0]

    while "{" in template:
        template = re.sub(r"\{([^{}]*)\}", filled, template)
    return template


@pytest.mark.parametrize("key", TEMPLATES)
def test_no_sentence_has_more_than_35_words(key):
    for sentence in re.split(r"(?<=[.!?])\s+(?=[A-Z])", longest(TEMPLATES[key])):
        assert len(re.findall(r"\S*\w\S*", sentence)) <= 35, sentence


def test_every_key_in_the_code_is_in_the_catalogue():
    keys = {
        node.args[0].value
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Message"
        and node.args and isinstance(node.args[0], ast.Constant)
    }  # fmt: skip
    assert len(keys) > 80
    assert keys - set(TEMPLATES) == set()


def test_clauses_and_nouns_are_used():
    used = {name for text in (*TEMPLATES.values(), *CATALOGUE["clause"].values()) for name, _ in fields_in(text)}
    assert set(CATALOGUE["clause"]) - used == set()
    assert set(CATALOGUE) == {"error", "warning", "statement", "nothing", "advice", "clause", "noun"}


def test_a_share_beyond_reason_is_told_as_such():
    assert "leaves more than 1000 % of the voltage" in Message("unexplained.fit", unexplained=7e40)
    assert "leaves 450 % of the voltage" in Message("unexplained.fit", unexplained=4.5)


@pytest.mark.parametrize("key", TEMPLATES)
def test_one_is_singular(key):
    """All numbers at 1, in all parts of the sentence, as a count may be."""
    fields = [
        (name, spec) for text in (TEMPLATES[key], *CATALOGUE["clause"].values()) for name, spec in fields_in(text)
    ]
    names = {name for name, _ in fields} - {*CATALOGUE["clause"], "several"}
    nouns = {name for name, spec in fields if "nouns" in spec}
    sentence = Message(key, **{name: "iron_loss" if name in nouns else 1 for name in names})
    assert not re.search(rf"(?<![\d.])1 ([a-z]+ )??({COUNTED})\b", sentence), sentence
    assert not re.search(r"(?<![\d.])1 (?!more)[a-z]+( of 1)? (are|were|have|lack|lie)\b", sentence), sentence


def test_counts_in_the_code_agree():
    """In texts that the code itself puts together; a name in capitals is a limit, larger than 1."""
    counted = (
        r" ((?!holds )[a-z]+ )??(bytes|entries|gaps|messages|parts|places|recordings|requests|results|rows|samples)\b"
    )
    odd = []
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            parts = node.values if isinstance(node, ast.JoinedStr) else []
            for value, text in pairwise(parts):
                if (
                    isinstance(value, ast.FormattedValue)
                    and value.format_spec is None
                    and isinstance(text, ast.Constant)
                    and re.match(counted, text.value)
                    and not re.match(r"_?[A-Z]|.*(join|method)", ast.unparse(value.value))
                ):
                    odd.append(f"{path.name}: {ast.unparse(value.value)}{text.value:.50}")
    assert odd == []


def test_a_name_of_a_damaged_file_is_no_missing_value():
    assert "dri" in Message("another_drive.frame", topic="/resolver", before="drive", after="dri\0\0")
