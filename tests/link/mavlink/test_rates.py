"""The rates are those of messages in the dialect, under their names."""

from twodof.link.mavlink import dialect
from twodof.link.mavlink.rates import GROUND, ONBOARD, RATES


def test_every_row_names_the_message_of_its_number() -> None:
    assert {row.number: row.name for row in RATES} == {
        row.number: dialect.load().mavlink_map[row.number].msgname for row in RATES
    }
    assert len({row.number for row in RATES}) == len(RATES)


def test_a_slow_link_is_sent_no_message_oftener_than_a_fast_one() -> None:
    assert GROUND.keys() <= ONBOARD.keys()
    for number, rate in GROUND.items():
        assert rate <= ONBOARD[number]
