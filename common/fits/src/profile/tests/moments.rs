//! Times, evenings and directions of a copy, at the moments at which they are easily wrong.

use super::*;

/// The cards of [`LIGHT`], with this one in the place of that of its keyword; none where it is empty.
pub fn changed<'a>(record: &'a str, keyword: &str) -> Vec<&'a str> {
    let mut records: Vec<&'a str> = LIGHT.to_vec();
    records.retain(|old| old[..8].trim_end() != keyword);
    records.extend(Some(record).filter(|record| !record.is_empty()));
    records
}

/// What breaks the rules of a profile in a header with these cards.
pub fn words(records: &[&str], name: ProfileName) -> Vec<String> {
    check::violations(&list(records), &profile(name)).iter().map(Violation::to_string).collect()
}

fn text(text: &str) -> Option<Value> {
    Some(Value::Text(text.to_owned()))
}

#[test]
fn a_longitude_beyond_180_degrees_gives_the_same_evening_as_its_western_form() {
    for (time, western, eastern, evening) in [
        ("2026-11-21T03:00:00", "-70.4", "289.6", "20261120"),
        ("2026-11-21T16:40:00", "-70.4", "289.6", "20261120"),
        ("2026-11-21T16:43:00", "-70.4", "289.6", "20261121"),
        ("2026-11-21T20:00:00", "-155.5", "204.5", "20261120"),
        ("2026-11-21T23:00:00", "-155.5", "204.5", "20261121"),
        ("2026-11-21T01:00:00", "150.0", "-210.0", "20261120"),
        ("2027-01-01T03:00:00", "-70.4", "289.6", "20261231"),
        ("2028-03-01T03:00:00", "-70.4", "289.6", "20280229"),
    ] {
        for longitude in [western, eastern] {
            let (date, place) = (format!("DATE-OBS= '{time}'"), format!("LONG-OBS= {longitude}"));
            let cards = list(&[&date, &place, "SCHEDROW= 7"]);
            assert_eq!(computed::computed("@day_obs", &cards, ""), text(evening), "{time} at {longitude}");
        }
    }
    let east = list(&["DATE-OBS= '2026-11-21T03:00:00'", "LONG-OBS= 289.6", "SCHEDROW= 7"]);
    // 2026-11-20 is MJD 61364.
    assert_eq!(computed::computed("@block", &east, ""), Some(Value::Whole(613_640_007)));
    for nowhere in ["LONG-OBS= 361.0", "LONG-OBS= NaN", "LONG-OBS= 'west'", "LATITUDE= 5.0"] {
        let cards = list(&["DATE-OBS= '2026-11-21T03:00:00'", nowhere, "SCHEDROW= 7"]);
        assert_eq!(computed::computed("@day_obs", &cards, ""), None, "{nowhere}");
        assert_eq!(computed::computed("@block", &cards, ""), None, "{nowhere}");
    }
}

#[test]
fn an_exposure_may_end_on_another_day_than_it_began() {
    for (start, exposure_s, end, ut_stop, utc_s) in [
        ("2026-12-31T23:59:50", "30.0", "2027-01-01T00:00:20.000000", "00:00:20.000", 86_390.0),
        ("2028-02-28T23:59:59.5", "1", "2028-02-29T00:00:00.500000", "00:00:00.500", 86_399.5),
        ("2027-02-28T23:59:59.999999", "0.000001", "2027-03-01T00:00:00.000000", "00:00:00.000", 86_399.999_999),
        ("2026-11-21T00:00:00", "0.0", "2026-11-21T00:00:00.000000", "00:00:00.000", 0.0),
        ("2026-11-21T03:12:41.006789", "7200.0", "2026-11-21T05:12:41.006789", "05:12:41.006", 11_561.006_789),
    ] {
        let (date, exposure) = (format!("DATE-OBS= '{start}'"), format!("EXPTIME = {exposure_s}"));
        let cards = list(&[&date, &exposure]);
        let value = |name: &str| computed::computed(name, &cards, "");
        assert_eq!(value("@date_end"), text(end), "{start}");
        assert_eq!(value("@ut_stop"), text(ut_stop), "{start}");
        assert_eq!(value("@utc_s"), Some(Value::Number(utc_s)), "{start}");
    }
    for exposure in ["EXPTIME = -1.0", "EXPTIME = 1.0E7", "EXPTIME = NaN", "EXPTIME = '30'", "EXPTIME ="] {
        let cards = list(&["DATE-OBS= '2026-11-21T03:00:00'", exposure]);
        for name in ["@date_end", "@mjd_end", "@ut_stop"] {
            assert_eq!(computed::computed(name, &cards, ""), None, "{name} of {exposure}");
        }
        assert!(computed::computed("@mjd_obs", &cards, "").is_some(), "the start is known: {exposure}");
    }
}

#[test]
fn a_direction_is_rounded_before_it_is_parted_and_none_is_made_of_nonsense() {
    for (keyword, value, name, expected) in [
        ("RA", "0.0", "@ra_hours", Some("00:00:00.0000")),
        ("RA", "359.99999999", "@ra_hours", Some("00:00:00.0000")),
        ("RA", "360.0", "@ra_hours", Some("00:00:00.0000")),
        ("RA", "15", "@ra_hours", Some("01:00:00.0000")),
        ("RA", "-0.1", "@ra_hours", None),
        ("RA", "360.1", "@ra_hours", None),
        ("RA", "'23:06:29'", "@ra_hours", None),
        ("DEC", "0.0", "@dec_degrees", Some("+00:00:00.000")),
        ("DEC", "-0.5", "@dec_degrees", Some("-00:30:00.000")),
        ("DEC", "89.9999999999", "@dec_degrees", Some("+90:00:00.000")),
        ("DEC", "-90", "@dec_degrees", Some("-90:00:00.000")),
        ("DEC", "-59.9999999999", "@dec_degrees", Some("-60:00:00.000")),
        ("DEC", "90.1", "@dec_degrees", None),
    ] {
        let card = format!("{keyword:<8}= {value}");
        assert_eq!(computed::computed(name, &list(&[&card]), ""), expected.and_then(text), "{card}");
    }
}

#[test]
fn a_row_has_a_block_of_its_own_or_none() {
    for (row, expected) in [
        ("SCHEDROW= 0", Some(613_640_000)),
        ("SCHEDROW= 9999", Some(613_649_999)),
        ("SCHEDROW= 10000", None),
        ("SCHEDROW= -1", None),
        ("SCHEDROW= 1.5", None),
        ("SCHEDROW= 'one'", None),
        ("NOROW   = 1", None),
    ] {
        let cards = list(&["DATE-OBS= '2026-11-21T03:00:00'", "NIGHT   = '20261120'", row]);
        assert_eq!(computed::computed("@block", &cards, ""), expected.map(Value::Whole), "{row}");
    }
    // A night that no calendar has is none: the evening follows from time and place.
    for night in ["20261131", "2026-1120", "202611", "night-20"] {
        let night = format!("NIGHT   = '{night}'");
        let cards = list(&["DATE-OBS= '2026-11-21T03:00:00'", "LONG-OBS= -70.4", &night]);
        assert_eq!(computed::computed("@day_obs", &cards, ""), text("20261120"), "{night}");
    }
}

#[test]
fn a_date_has_the_one_form_that_fits_has() {
    for (date, is_right) in [
        ("2026-11-21T03:12:41", true),
        ("2026-11-21T03:12:41.0", true),
        ("2026-11-21T03:12:41.006789", true),
        ("2028-02-29T00:00:00", true),
        ("2027-02-29T00:00:00", false),
        ("2026-11-21T03:12:41Z", false),
        ("2026-11-21T03:12:41.5Z", false),
        ("2026-11-21T03:12:41+00:00", false),
        ("2026-11-21T03:12:41,5", false),
        ("2026-11-21T03:12:41.", false),
        ("2026-11-21T03:12", false),
        ("20261121T031241", false),
        ("2026-11-21 03:12:41", false),
        ("2026-11-21T25:12:41", false),
        ("2026-11-21", false),
        ("yesterday", false),
    ] {
        let card = format!("DATE-OBS= '{date}'");
        for name in PROFILES {
            let found = words(&changed(&card, "DATE-OBS"), name);
            let refused = found.iter().any(|text| text.starts_with(&format!("DATE-OBS is '{date}'; expected a time")));
            assert_eq!(refused, !is_right, "{name} {date}: {found:?}");
        }
    }
}

#[test]
fn a_day_and_hours_have_only_digits_between_their_signs() {
    for (keyword, value, is_right) in [
        ("DAY-OBS", "20261120", true),
        ("DAY-OBS", "20280229", true),
        ("DAY-OBS", "20270229", false),
        ("DAY-OBS", "20261320", false),
        ("DAY-OBS", "2026-11-20", false),
        ("DAY-OBS", "+2026112", false),
        ("RA", "23:06:29.2824", true),
        ("RA", "00:00:00", true),
        ("RA", "24:00:00", false),
        ("RA", "23:60:00", false),
        ("RA", "23:06:60", false),
        ("RA", "+23:06:29", false),
        ("RA", "23:+6:29", false),
        ("RA", "23:06:2.9E1", false),
        ("RA", "23:06", false),
        ("DEC", "-05:02:28.788", true),
        ("DEC", "+05:02:28", true),
        ("DEC", "05:02:28", true),
        ("DEC", "--05:02:28", false),
        ("DEC", "+-05:02:28", false),
        ("DEC", "-05:-2:28", false),
    ] {
        let card = format!("{keyword:<8}= '{value}'");
        let found = words(&changed(&card, keyword), ProfileName::Lco);
        let refused = found.iter().any(|text| text.starts_with(&format!("{keyword} is '{value}'; expected")));
        assert_eq!(refused, !is_right, "{card}: {found:?}");
    }
}
