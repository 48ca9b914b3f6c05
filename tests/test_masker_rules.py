"""What is masked in texts and JSON: secrets of a tree in all their spellings, and nothing that rorg itself must say."""

from __future__ import annotations

import json

import pytest

from rorg.core.masking import MASK, Masker, forms, hidden, secrets
from rorg.model.catalog import SHORTEST_SECRET, Catalog, Service


def catalog(**values: dict[str, str]) -> Catalog:
    """Services with these secret variables."""
    return Catalog({n: Service(n, spec={"environment": v}, secrets=tuple(v)) for n, v in values.items()})


@pytest.fixture
def masker():
    found = Masker()
    found.learn(catalog(arm={"KEY": "secret-of-arm"}, drive={"KEY": "secret-of-drive"}))
    return found


def test_an_empty_masker_changes_nothing():
    masker, value = Masker(), {"a": ["secret-of-arm"]}
    masker.learn(None)
    assert not masker.knows
    assert masker.text("secret-of-arm") == "secret-of-arm"
    assert masker.value(value) is value
    assert masker.json('{"a": 1}\n') == '{"a": 1}\n'


def test_a_service_is_masked_by_its_own_secrets_only(masker):
    said = "secret-of-arm secret-of-drive"
    assert masker.knows is True
    assert masker.text(said) == f"{MASK} {MASK}"
    assert masker.of("arm").text(said) == f"{MASK} secret-of-drive"
    assert masker.of("drive").text(said) == f"secret-of-arm {MASK}"
    other = Masker()
    assert masker.of("unknown") is masker.of(None) is masker.of(7) is masker
    assert masker.of("unknown", other) is other
    assert masker.of("arm", other) is not other


def test_a_secret_stays_one_when_it_is_learnt_again(masker):
    masker.learn(catalog(arm={"KEY": "secret-of-arm"}))
    masker.learn(catalog(arm={"KEY": "another-secret"}))
    assert masker.text("secret-of-arm, secret-of-drive, another-secret") == f"{MASK}, {MASK}, {MASK}"
    assert masker.of("arm").text("secret-of-arm, another-secret") == f"{MASK}, {MASK}"


def test_values_are_masked_and_keys_are_not(masker):
    value = {"secret-of-arm": ["secret-of-arm", 7, None], "deep": {"text": ("a secret-of-arm",)}}
    assert masker.value(value) == {"secret-of-arm": [MASK, 7, None], "deep": {"text": [f"a {MASK}"]}}
    assert masker.value(True) is True
    assert json.loads(masker.json(json.dumps(value))) == masker.value(value)


def test_names_and_ids_are_cited_as_they_are(masker):
    """Their callers chose them: masking one would tell a caller that it has guessed a secret."""
    assert masker.value({"id": "secret-of-arm", "services": ["secret-of-arm"], "text": "secret-of-arm"}) == {
        "id": "secret-of-arm",
        "services": ["secret-of-arm"],
        "text": MASK,
    }
    assert masker.value({"services": [{"text": "secret-of-arm"}]}) == {"services": [{"text": MASK}]}
    said = "request 'secret-of-arm' of developer names it: secret-of-arm"
    assert masker.text(said) == f"request 'secret-of-arm' of developer names it: {MASK}"


def test_json_keeps_its_end_and_what_is_no_json_is_text(masker):
    assert masker.json('{"a": "secret-of-arm"}\n') == f'{{"a": "{MASK}"}}\n'
    assert masker.json("{secret-of-arm") == f"{{{MASK}"


def test_what_is_too_short_or_what_rorg_must_say_is_no_secret():
    short, long = "x" * (SHORTEST_SECRET - 1), "-" * SHORTEST_SECRET
    assert secrets(catalog(arm={"A": short, "B": long, "C": ""})) == {long}
    masker = Masker()
    masker.learn(catalog(navigation_of_robot={"A": "navigation_of", "B": long}))
    assert masker.text(f"navigation_of_robot {long}") == f"navigation_of_robot {MASK}"


def test_every_spelling_is_looked_for_the_longest_first():
    found = forms(["it's a\nlong secret"])
    assert {"it's a\nlong secret", "long secret", "it's a\\nlong secret", "it''s a\nlong secret"} <= {*found}
    assert "it's a long secret" in found, "as YAML folds it"
    assert "it%27s%20a%0Along%20secret" in found
    assert list(found) == sorted(found, key=lambda f: (-len(f), f))
    assert all(len(form) >= SHORTEST_SECRET for form in forms(["ab\nlong secret"]))
    assert hidden("abcdef abc", ("abcdef", "abc")) == f"{MASK} {MASK}"
