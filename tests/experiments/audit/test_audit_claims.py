"""Claims and their checks belong together, and their verdicts reach the files as they are."""

import shutil

import pandas as pd
import pytest
from places import ROOT

from deepmds_keras.io.errors import InputError
from experiments.audit.checks import CHECKS, NOT_KEPT, TOPICS, topic_of
from experiments.audit.claim_tables import COLUMNS, combine, latex, table_of
from experiments.audit.claims import Claim, described, judge, load_claims
from experiments.audit.findings import (
    does_not_hold,
    holds,
    holds_if,
    unknown,
)
from experiments.face_models import TITLES
from experiments.markup.markdown import markdown
from experiments.verdicts import DOES_NOT_HOLD, VERDICTS, counted, listed, phrase

RESULTS = ROOT / "results"
NAMES = {"openhead": "the open head", "ict": "ICT faces"}


def smaller(a, b):
    return holds(f"{a}") if a < b else does_not_hold(f"{a}")


def test_every_claim_has_a_check_and_every_check_a_claim():
    assert CHECKS.keys() == load_claims().keys()


def test_every_check_belongs_to_a_topic_that_measures():
    assert {topic_of(check) for check in CHECKS.values()} == TOPICS.keys()
    assert all(callable(module.measure) for module in TOPICS.values())
    assert {*NOT_KEPT} < TOPICS.keys()


def test_every_check_says_what_it_asks():
    assert all(check.__doc__ for check in CHECKS.values())


def test_a_check_gets_what_it_names_of_measured_and_printed_numbers():
    claim = Claim("x", "Results", "A is below b.", {"b": 3.0})
    assert judge(claim, smaller, {"a": 2, "c": 9}) == holds("2")
    assert judge(claim, smaller, {"a": 4}) == does_not_hold("4")
    with pytest.raises(KeyError):
        judge(claim, smaller, {})


def test_a_check_is_described_as_it_is_called():
    assert described(smaller) == "test_audit_claims.smaller(a, b)"


def write(path, rows):
    path.write_text("id,where,claim,numbers\n" + rows)
    return path


def test_numbers_of_a_claim_are_read_by_name(tmp_path):
    rows = "a,Results,Text.,n=10; level=5e-2\nb,Text,T.,\n"
    claims = load_claims(write(tmp_path / "claims.csv", rows))
    assert claims["a"].numbers == {"n": 10, "level": 0.05}
    assert claims["b"].numbers == {}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("a,Results,Text.,ten\n", "must be name=value"),
        ("a,Results,Text.,n=ten\n", "must be name=value"),
        ("a,Results,One.,\na,Results,Two.,\n", "must name each claim once. Received a twice"),
    ],
)
def test_a_damaged_file_of_claims_is_refused(tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        load_claims(write(tmp_path / "claims.csv", rows))


def findings(*verdicts):
    """Of the first claims these, of the others that they do not hold."""
    rest = [does_not_hold("No.")] * (len(CHECKS) - len(verdicts))
    return dict(zip(CHECKS, (*verdicts, *rest), strict=True))


@pytest.fixture
def table():
    first = (unknown("a scan"), does_not_hold("9"), holds_if("for | some", "8 < 9"), holds("7"))
    return table_of(load_claims(), findings(*first), "ict")


def test_claims_that_hold_come_first(table):
    first = [*CHECKS]
    assert [*table.columns] == [*COLUMNS]
    assert [*table["id"][:3]] == [first[3], first[2], first[0]]
    assert [*table["verdict"].drop_duplicates()] == [*VERDICTS]
    assert len(table) == len(CHECKS)


def test_face_models_are_put_side_by_side(table, tmp_path):
    other = table_of(load_claims(), findings(holds("6"), holds("5")), "openhead")
    for model, own in (("ict", table), ("openhead", other)):
        (tmp_path / model / "audit").mkdir(parents=True)
        own.to_csv(tmp_path / model / "audit" / "claims.csv", index=False)
    folder = combine(tmp_path, NAMES)
    both = pd.read_csv(folder / "claims.csv", keep_default_na=False)
    assert len(both) == 2 * len(CHECKS)
    assert [*both["id"][::2]] == [*both["id"][1::2]], "rows of one claim stand together"
    text = (folder / "claims.md").read_text()
    row = next(line for line in text.splitlines() if line.startswith(f"| {other['claim'][0]}"))
    assert "| holds | cannot be checked without a scan |" in row
    assert "holds for | some" not in text, "a bar in a cell would end it"
    tex = (folder / "claims.tex").read_text()
    assert "cannot be checked without a scan" in tex
    heads = 3  # of the first page and the others, and the foot of all but the last
    assert tex.count(r"\\") == len(CHECKS) + heads


def test_a_model_that_was_not_run_is_said_to_be(table):
    more = pd.concat([table, table.iloc[:1].assign(model="openhead")])
    assert "| not run |" in markdown("markup/claims_page.md.j2", of=listed(more, NAMES))
    assert "--" in latex(more, NAMES)


def test_verdicts_are_counted_as_they_are_read(table):
    assert counted(table).startswith("1 holds, 1 holds with a condition, 1 cannot be checked, ")
    assert counted(table).endswith(f"{len(CHECKS) - 3} do not hold")
    assert phrase("holds", "") == "holds"
    assert phrase(VERDICTS[1], "for yaws up to 45°") == "holds for yaws up to 45°"


def test_committed_claims_are_those_of_the_face_models(tmp_path):
    for model in TITLES:
        path = RESULTS / model / "audit" / "claims.csv"
        if path.exists():
            (tmp_path / model / "audit").mkdir(parents=True)
            shutil.copy(path, tmp_path / model / "audit")
    made = combine(tmp_path, TITLES)
    for path in (RESULTS / "audit").iterdir():
        assert path.read_text() == (made / path.name).read_text(), path.name
    assert {path.name for path in made.iterdir()} == {p.name for p in (RESULTS / "audit").iterdir()}


@pytest.mark.parametrize("model", ["openhead", "ict"])
def test_committed_verdicts_are_on_the_claims_as_they_are_now(model):
    table = pd.read_csv(RESULTS / model / "audit" / "claims.csv", keep_default_na=False)
    claims = load_claims()
    assert {*table["id"]} == claims.keys()
    for row in table.itertuples():
        own = claims[row.id]
        assert (row.claim, row.where) == (own.claim, own.where)
        assert row.check == described(CHECKS[row.id])


def test_verdicts_by_other_factors_stand_beside_those_that_depend_on_one():
    claim = Claim("as-good", "Results", "It is as good.", {})

    def as_good(ratio, alike=1.5):
        return holds("1.8 times.") if ratio <= alike else does_not_hold("1.8 times.")

    found = judge(claim, as_good, {"ratio": 1.8})
    assert found.verdict == DOES_NOT_HOLD
    assert found.evidence == (
        "1.8 times. Errors within a factor of 1.5 count as alike; "
        'with 1.2 the verdict is "does not hold" and with 2 the verdict is "holds".'
    )
    assert described(as_good).endswith("as_good(ratio)")
    assert judge(claim, lambda ratio: holds("1."), {"ratio": 1.8}).evidence == "1."
