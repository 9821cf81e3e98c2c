//! A property drawn over any time, whatever was polled when: nothing is hidden, and nothing is shown that is not there.

use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, MOST_PROPERTIES, Series, SeriesName};
use contract::{Address, Kind};
use proptest::prelude::*;
use rusqlite::Connection;

use super::*;
use crate::database::migrations;
use crate::reader::Reader;

const NOON_S: i64 = 1_795_219_200;
const GUST_MPS: f64 = 31.5;

fn at(second: i64) -> Utc {
    Utc::from_micros((NOON_S + second) * 1_000_000)
}

/// A time in which a device is polled, and is switched off afterwards.
#[derive(Debug, Clone)]
struct Watch {
    every_s: i64,
    polls: i64,
    off_s: i64,
}

fn watches() -> impl Strategy<Value = Vec<Watch>> {
    let off_s = prop_oneof![Just(0), 1_i64..600, 3600_i64..400_000];
    let one = (1_i64..61, 1_i64..1500, off_s).prop_map(|(every_s, polls, off_s)| Watch { every_s, polls, off_s });
    proptest::collection::vec(one, 1..6)
}

/// The seconds of all polls, and the times of at least so many seconds in which nothing was polled.
fn seconds(watches: &[Watch]) -> Vec<i64> {
    let (mut second, mut all) = (0, Vec::new());
    for watch in watches {
        all.extend((0..watch.polls).map(|poll| second + poll * watch.every_s));
        second += watch.polls * watch.every_s + watch.off_s;
    }
    all
}

struct Archive {
    folder: tempfile::TempDir,
    connection: Connection,
}

impl Archive {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut connection = Connection::open(folder.path().join("archive.db")).unwrap();
        connection.execute_batch("PRAGMA synchronous = OFF").unwrap();
        migrations::bring_up(&mut connection).unwrap();
        Self { folder, connection }
    }

    fn write(&mut self, property: &str, values: impl IntoIterator<Item = (i64, Result<Scalar, String>)>) {
        let device =
            Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
        let (transaction, mut telemetry) = (self.connection.transaction().unwrap(), Telemetry::default());
        for (second, value) in values {
            telemetry.write(&transaction, (&device, property), &value, at(second)).unwrap();
        }
        telemetry.write_minutes(&transaction).unwrap();
        transaction.commit().unwrap();
    }

    /// Forgets the values of all but the newest so many days with values.
    fn forget(&mut self, days: u32) {
        let days_left = |connection: &Connection| -> u32 {
            connection.query_row("SELECT count(*) FROM days", [], |row| row.get(0)).unwrap()
        };
        while days_left(&self.connection) > days {
            let transaction = self.connection.transaction().unwrap();
            Telemetry::default().forget_old(&transaction, days).unwrap();
            transaction.commit().unwrap();
        }
    }

    fn ask(
        &self,
        properties: Vec<SeriesName>,
        between: (Option<Utc>, Option<Utc>),
        points: u32,
        now: Utc,
    ) -> ArchiveAnswer {
        let ask = Ask::Series { properties, points };
        let question = ArchiveQuestion { ask, from_utc: between.0, to_utc: between.1, limit: None };
        let reader = Reader::open(&self.folder.path().join("archive.db"), "callisto").unwrap();
        reader.answer(&question, now).unwrap()
    }

    fn drawn(&self, property: &str, between: (Utc, Utc), points: u32, now: Utc) -> Series {
        let mut answer = self.ask(vec![name(property)], (Some(between.0), Some(between.1)), points, now);
        match answer.rows.pop() {
            Some(ArchiveRow::Series(series)) => series,
            other => panic!("{other:?}"),
        }
    }
}

fn name(property: &str) -> SeriesName {
    SeriesName { kind: Kind::ObservingConditions, device: "wx".to_owned(), property: property.to_owned() }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]
    #[test]
    fn no_extreme_is_lost_gaps_are_empty_and_points_are_few_whatever_was_polled(
        watches in watches(),
        (gust, from, to) in (0.0_f64..1.0, -0.2_f64..1.2, -0.2_f64..1.2),
        points in 1_u32..400,
        raw_days in 1_u32..4,
    ) {
        let polled = seconds(&watches);
        let (first, last) = (polled[0], *polled.last().unwrap());
        let of_all = |share: f64| first + (share * (last - first) as f64) as i64;
        let (from, to) = (of_all(from.min(to)), of_all(from.max(to)) + 1);
        // Five seconds of wind begin at one of the polls.
        let gust = polled[((polled.len() - 1) as f64 * gust) as usize];
        let calm = polled.iter().map(|second| (*second, Ok(Scalar::Float(2.0))));
        let mut archive = Archive::new();
        let windy = (gust..gust + 5).map(|second| (second, Ok(Scalar::Float(GUST_MPS))));
        archive.write("WindGust", windy.chain(calm));
        archive.forget(raw_days);

        let series = archive.drawn("WindGust", (at(from), at(to)), points, at(to));
        prop_assert!(series.points.len() <= points as usize, "{} of {points}", series.points.len());
        if from <= gust && gust < to {
            let highest = series.points.iter().filter_map(|point| point.max).fold(f64::NEG_INFINITY, f64::max);
            prop_assert_eq!(highest, GUST_MPS);
        }
        for gap in &series.gaps {
            let inside = |at: Utc| gap.from_utc < at && at < gap.to_utc;
            let in_gap: Vec<_> = series.points.iter().filter(|point| inside(point.at_utc)).collect();
            prop_assert!(in_gap.is_empty(), "{gap:?} has {in_gap:?}");
            let value = polled.iter().copied().chain(gust..gust + 5).find(|second| inside(at(*second)));
            prop_assert_eq!(value, None, "{:?}", gap);
            prop_assert!(at(from) <= gap.from_utc && gap.to_utc <= at(to), "{gap:?}");
        }
        for pair in series.gaps.windows(2) {
            prop_assert!(pair[0].to_utc <= pair[1].from_utc, "{pair:?}");
        }
        // A time in which the device was off is a gap, unless it is short or a part of one point.
        let noticed_s = 3 * 60 + 60 + series.piece_s as i64;
        for pair in polled.windows(2).filter(|pair| pair[1] - pair[0] > noticed_s) {
            let (off, on) = (pair[0].max(gust + 4).max(from), pair[1].min(to));
            if off < gust + 5 && gust < on && gust > pair[0] || on - off <= noticed_s {
                continue;
            }
            let middle = at(off.midpoint(on));
            prop_assert!(series.gaps.iter().any(|gap| gap.from_utc < middle && middle < gap.to_utc), "{pair:?}: {:?}", series.gaps);
        }
    }
}

#[test]
fn a_series_that_is_asked_for_strangely_is_answered() {
    let mut archive = Archive::new();
    archive.write("Humidity", (0..7200).map(|second| (second, Ok(Scalar::Int(second)))));
    let (now, ever) = (at(7200), (Utc::from_micros(i64::MIN), Utc::from_micros(i64::MAX)));
    let drawn = |between: (Utc, Utc), points: u32| {
        let series = archive.drawn("Humidity", between, points, now);
        let count: u64 = series.points.iter().map(|point| point.count).sum();
        (series.points.len(), count, series.gaps.len())
    };
    for (what, between, points, expected) in [
        ("it ends before it begins", (at(3600), at(0)), 100, (0, 0, 0)),
        ("an instant", (at(60), at(60)), 100, (0, 0, 0)),
        ("an instant of a value", (at(60), Utc::from_micros(at(60).micros() + 1)), 100, (1, 1, 0)),
        ("the future", (at(8000), at(9000)), 100, (0, 0, 0)),
        ("until the future", (at(7100), at(99_000)), u32::MAX, (100, 100, 0)),
        ("no point", (at(0), at(7200)), 0, (1, 7200, 0)),
        ("very many points", (at(0), at(7200)), u32::MAX, (7200, 7200, 0)),
        ("before anything", (at(-900), at(-600)), 10, (0, 0, 1)),
        ("half a minute before anything", (at(-60), at(-30)), 10, (0, 0, 1)),
        ("all time", ever, 10, (1, 7200, 1)),
        ("all time, in one point", ever, 0, (1, 7200, 0)),
    ] {
        assert_eq!(drawn(between, points), expected, "{what}");
    }
}

#[test]
fn properties_that_are_too_many_or_not_there_are_answered_and_counted() {
    let mut archive = Archive::new();
    archive.write("Humidity", [(0, Ok(Scalar::Int(40)))]);
    let all = |count: usize| (0..count).map(|number| name(&format!("Property{number}"))).collect::<Vec<_>>();
    let ask = |properties| archive.ask(properties, (None, None), u32::MAX, at(60));
    let none = ask(vec![]);
    assert_eq!((none.rows.len(), none.truncated, none.cut), (0, false, None));
    assert_eq!(ask(all(MOST_PROPERTIES)).cut, None);
    let many = ask(all(10_000));
    assert_eq!((many.rows.len(), many.truncated), (MOST_PROPERTIES, true));
    assert!(many.cut.unwrap().starts_with("of 10000 properties the first 64 are answered"));
}

#[test]
fn a_value_that_is_no_number_is_no_value_and_hides_no_other() {
    let mut archive = Archive::new();
    let value = |second: i64| match second % 3 {
        0 => Scalar::Float(f64::NAN),
        1 => Scalar::Float(2.0),
        _ => Scalar::Float(4.0),
    };
    archive.write("WindSpeed", (0..600).map(|second| (second, Ok(value(second)))));
    for points in [5, 10_000] {
        let series = archive.drawn("WindSpeed", (at(0), at(600)), points, at(600));
        let (count, mean): (u64, f64) = series.points.iter().fold((0, 0.0), |(count, sum), point| {
            (count + point.count, sum + point.mean.unwrap() * point.count as f64)
        });
        assert_eq!((count, mean), (400, 1200.0), "{points} points: {:?}", series.points.first());
        assert_eq!(series.gaps, vec![]);
    }
    let device = Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
    let reader = Reader::open(&archive.folder.path().join("archive.db"), "callisto").unwrap();
    let around = reader.around(&device, "WindSpeed", at(301)).unwrap();
    assert_eq!(around.before.first().map(|sample| sample.at), Some(at(299)));
}
