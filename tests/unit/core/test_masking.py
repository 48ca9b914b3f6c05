"""What is masked in texts and JSON: secrets of a tree in all their spellings, and nothing that rorg itself must say."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from rorg.core.masking import MASK, Masker, forms, hidden, masked, secrets
from rorg.model.catalog import SHORTEST_SECRET, Catalog, Image, Service


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


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (["sshpass", "-p", "hunter22", "ssh"], ["sshpass", "-p", "***", "ssh"]),
        (["/usr/bin/sshpass", "-phunter22"], ["/usr/bin/sshpass", "-p***"]),
        (["sshpass", 5, "-p", 7, None], ["sshpass", 5, "-p", "***", None]),
        (["nginx", "-p", "8080"], ["nginx", "-p", "8080"]),
        (["run", "--token", "hunter22", "--port", "80"], ["run", "--token", "***", "--port", "80"]),
        (["redis-cli", "-a", "hunter22"], ["redis-cli", "-a", "***"]),
        (["curl", "-u", "me:hunter22", "url"], ["curl", "-u", "***", "url"]),
        (["sh", "-c", "curl -u me:hunter22 url; nginx -p 80"], ["sh", "-c", "curl -u *** url; nginx -p 80"]),
        ([], []),
    ],
)
def test_words_of_a_command_are_masked_by_the_option_before(words, shown):
    assert masked("command", words) == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("mysql -phunter22 -h db", "mysql -p*** -h db"),
        ("mysql -p hunter22 ; psql -p 5432", "mysql -p *** ; psql -p 5432"),
        ("mysqldump db", "mysqldump db"),
        ("mysql -p", "mysql -p"),
        ("curl -u me:x a | curl -u me:y b", "curl -u *** a | curl -u *** b"),
        ("Authorization: Bearer abc", "Authorization: Bearer ***"),
        ("amqp://me:hunter22@host/x", "amqp://me:***@host/x"),
        ("TOKEN=abc run", "TOKEN=*** run"),
        ("password: abc", "password: ***"),
        ("/a:/token:ro", "/a:/token:ro"),
    ],
)
def test_a_text_is_masked_by_its_form(text, shown):
    assert masked("command", text) == shown


def test_values_are_masked_by_the_name_of_their_field():
    assert masked("environment.MODE", "fast") == "***"
    assert [masked("environment.N", plain) for plain in ("1", "true", "off", "", None)] == [
        "1",
        "true",
        "off",
        "",
        None,
    ]
    assert masked("environment.N", 1) == "***"
    assert masked("api_key", "x") == masked("api_key", ["x"]) == "***"
    assert masked("labels", {"token": "x", "team": "arm"}) == {"token": "***", "team": "arm"}
    assert masked("cpus", 2.0) == 2.0


def test_names_that_managed_services_chose_expose_no_secret():
    """Such a name makes no secret sayable, and is shown itself."""
    secret = "hunter22"
    keeper = Service("keeper", spec={"environment": {"TOKEN": secret}}, secrets=("TOKEN",), may_manage=("guest-*",))
    guest = Service(f"guest-{secret}", spec={"image": "x"})
    masker = Masker()
    masker.learn(Catalog({s.name: s for s in (keeper, guest)}))
    assert masker.text(f"{guest.name} says {secret}") == f"{guest.name} says ***"
    masker = Masker()
    masker.learn(Catalog({s.name: s for s in (replace(keeper, may_manage=()), guest)}))
    assert masker.text(f"{guest.name} says {secret}") == f"{guest.name} says {secret}", "rorg must be able to say it"


def test_secrets_of_images_belong_to_what_is_built_from_them():
    image = Image("base", None, "", {"KEY": "hunter22"}, None, "", bases=("base", "other"), secrets=("KEY",))
    above = Image("arm", None, "", {}, None, "", bases=("base",))
    service = Service("arm", spec={"image": "arm:latest"})
    masker = Masker()
    masker.learn(
        Catalog({"arm": service, "map": Service("map", spec={"image": "x"})}, images={"base": image, "arm": above})
    )
    assert masker.of("arm").text("hunter22") == "***"
    assert masker.of("map").text("hunter22") == "hunter22"
    assert masker.text("hunter22") == "***"
