//! Files written and read again, without a database.

use std::path::Path;

use rusqlite::types::{ToSqlOutput, Value, ValueRef};

use super::*;
use crate::table::{Column, Kind};

const ABOUT: [(&str, &str); 3] = [("site", "paranal"), ("telescope", "callisto"), ("night", "20261121")];

fn minutes() -> &'static Table {
    TABLES.iter().find(|table| table.name == "minutes").unwrap()
}

fn row(device: &str, minute: i64, mean: Option<f64>) -> Vec<Cell> {
    let number = |value: Option<f64>| value.map_or(Cell::Null, Cell::Real);
    vec![
        Cell::text("ObservingConditions"),
        Cell::text(device),
        Cell::text("Température"),
        Cell::text("callisto"),
        Cell::Int(minute * 60_000_000),
        Cell::Int(60),
        Cell::Int(0),
        number(mean),
        number(mean),
        number(mean),
        Cell::Null,
        Cell::Null,
        Cell::Int(i64::MAX),
        Cell::text(""),
    ]
}

fn write(path: &Path, rows: &[Vec<Cell>]) {
    let mut writer = PartWriter::create(path, minutes(), &ABOUT).unwrap();
    for row in rows {
        writer.push(row.clone()).unwrap();
    }
    assert_eq!(writer.finish().unwrap(), rows.len());
}

fn read(path: &Path) -> Vec<Vec<Cell>> {
    let mut reader = PartReader::open(path, minutes(), &ABOUT).unwrap();
    std::iter::from_fn(|| reader.next_row().unwrap()).collect()
}

#[test]
fn rows_of_several_row_groups_come_back_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    let rows: Vec<Vec<Cell>> = (0..150_000)
        .map(|at| row(if at < 5000 { "a" } else { "b" }, at, (at % 3 > 0).then_some(at as f64 / 7.0)))
        .collect();
    write(&path, &rows);
    assert!(read(&path) == rows);
    // The same rows give the same bytes, which is how a night that has not changed is found.
    let again = folder.path().join("again");
    write(&again, &rows);
    assert!(is_same(&path, &again).unwrap());
    write(&folder.path().join("none"), &[]);
    assert!(read(&folder.path().join("none")).is_empty());
}

#[test]
fn extreme_numbers_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    let numbers = [f64::INFINITY, f64::NEG_INFINITY, -0.0, f64::MIN_POSITIVE, f64::MAX, 5e-324];
    let rows: Vec<_> = numbers.iter().zip(0..).map(|(number, at)| row("a", at, Some(*number))).collect();
    write(&path, &rows);
    assert_eq!(read(&path), rows);
}

#[test]
fn a_file_that_is_cut_off_or_of_another_night_or_table_is_refused_with_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    write(&path, &[row("a", 0, None)]);
    let refused = |path: &Path, table, about: &[(&str, &str)]| {
        let Err(error) = PartReader::open(path, table, about) else { panic!("{path:?} was opened") };
        error.to_string()
    };
    let other = refused(&path, minutes(), &[("night", "20261122")]);
    assert!(other.contains("written for night 20261121, and its folder is that of 20261122"), "{other}");
    let images = TABLES.iter().find(|table| table.name == "images").unwrap();
    assert!(refused(&path, images, &ABOUT).contains("is no file of the table images"));
    let whole = fs::read(&path).unwrap();
    for length in [0, 3, whole.len() / 2, whole.len() - 1] {
        let cut = folder.path().join("cut");
        fs::write(&cut, whole.get(..length).unwrap()).unwrap();
        assert!(refused(&cut, minutes(), &ABOUT).contains("cut"), "{length} bytes");
    }
}

#[test]
fn a_file_from_before_a_column_was_added_is_read_and_one_of_a_newer_program_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let shorter: &'static Table =
        Box::leak(Box::new(Table { columns: minutes().columns.split_last().unwrap().1, ..shape() }));
    let path = folder.path().join("part");
    let mut writer = PartWriter::create(&path, shorter, &ABOUT).unwrap();
    writer.push(row("a", 0, None)).unwrap();
    writer.finish().unwrap();
    assert_eq!(read(&path).pop().unwrap().pop(), Some(Cell::Null));
    let newer = folder.path().join("newer");
    write(&newer, &[row("a", 0, None)]);
    let Err(error) = PartReader::open(&newer, shorter, &ABOUT) else { panic!("it was opened") };
    assert!(error.to_string().contains("it has 14 columns, and 13 are known"), "{error}");
}

fn shape() -> Table {
    let Table { name, about, columns, key, group, prefer, from, next, insert, into, owner, before } = *minutes();
    Table { name, about, columns, key, group, prefer, from, next, insert, into, owner, before }
}

#[test]
fn the_larger_count_decides_between_two_rows_of_one_minute() {
    let (mut fuller, emptier) = (row("a", 0, Some(1.0)), row("a", 0, Some(2.0)));
    fuller[5] = Cell::Int(61);
    assert_eq!(chosen(minutes(), Some(emptier.clone()), Some(fuller.clone())), Some(fuller.clone()));
    assert_eq!(chosen(minutes(), Some(fuller.clone()), Some(emptier.clone())), Some(fuller));
    assert_eq!(chosen(minutes(), Some(emptier.clone()), None), Some(emptier));
}

#[test]
fn row_groups_of_every_length_come_back() {
    let folder = tempfile::tempdir().unwrap();
    for (count, per_device) in [(1, 1), (4096, 1), (4097, 1), (8192, 4096), (65_535, 70_000), (65_536, 70_000)] {
        let path = folder.path().join(format!("{count}-{per_device}"));
        let rows: Vec<_> =
            (0..count).map(|at| row(&format!("{:05}", at / per_device), at, (at % 2 > 0).then_some(0.5))).collect();
        write(&path, &rows);
        assert!(read(&path) == rows, "{count} rows, {per_device} of a device");
    }
}

fn partition(root: &Path) -> Partition {
    Partition { root: root.to_owned(), site: "paranal".to_owned(), telescope: "callisto".to_owned() }
}

fn night() -> NightSpan {
    let from: Utc = "2026-11-21T16:41:36Z".parse().unwrap();
    NightSpan { date: "20261121".to_owned(), from, to: from.plus_seconds(86_400.0) }
}

#[test]
fn two_writers_of_one_file_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let (partition, night) = (partition(folder.path()), night());
    let mut drafts: Vec<Draft> = (0..3).map(|_| Draft::begin(&partition, &night, minutes()).unwrap()).collect();
    for draft in &mut drafts {
        draft.writer.push(row("a", 0, Some(1.0))).unwrap();
    }
    let outcomes: Vec<Outcome> = drafts.into_iter().map(|draft| draft.publish().unwrap().outcome).collect();
    assert_eq!(outcomes, [Outcome::Written, Outcome::Unchanged, Outcome::Unchanged]);
    let path = partition.part(minutes(), &night.date);
    assert_eq!(read(&path).len(), 1);
    assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn what_a_killed_writer_left_goes_after_an_hour_and_what_others_put_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (partition, night) = (partition(folder.path()), night());
    let nights = partition.part(minutes(), &night.date);
    let in_folder = |name: &str| nights.with_file_name(name);
    fs::create_dir_all(nights.parent().unwrap()).unwrap();
    let cases = [
        ("part-0.parquet.part-1", 2.0, false),
        ("part-0.parquet.part-1-0", 2.0, false),
        ("part-0.parquet.part-2-0", 0.5, true),
        ("part-0.parquet.part-3-0", -0.5, true),
        ("part-0.parquet.part-4-0", -2.0, false),
        ("notes.txt", 2.0, true),
        ("part-0.parquet.old", 2.0, true),
    ];
    let at = |hours: f64| match SystemTime::now() {
        now if hours < 0.0 => now + Duration::from_secs_f64(-hours * 3600.0),
        now => now - Duration::from_secs_f64(hours * 3600.0),
    };
    for (name, hours, _) in cases {
        fs::write(in_folder(name), "PAR1").unwrap();
        let file = File::options().write(true).open(in_folder(name)).unwrap();
        file.set_modified(at(hours)).unwrap();
    }
    drop(Draft::begin(&partition, &night, minutes()).unwrap());
    for (name, hours, stays) in cases {
        assert_eq!(in_folder(name).exists(), stays, "{name}, {hours} h old");
    }
    assert!(!nights.exists(), "a draft that is dropped makes no file");
    assert!(partition.nights(minutes()).unwrap().is_empty());
}

#[test]
fn every_table_has_a_key_of_given_columns_and_prefers_by_one_of_its_own() {
    for table in TABLES.iter().chain([&NIGHTS]) {
        let keys = table.columns.get(..table.key).unwrap_or_default();
        assert!(!keys.is_empty() && table.group <= table.key, "{}", table.name);
        // A derived column is not put back, and a row of the file with no value in its key has no place in the order.
        assert!(keys.iter().all(|column| column.required && !column.derived), "{}", table.name);
        assert_eq!(table.preferred().is_some(), table.prefer.is_some(), "{}", table.name);
        let mut names: Vec<&str> = table.columns.iter().map(|column| column.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), table.columns.len(), "{}", table.name);
    }
}

const fn column(kind: Kind, required: bool) -> Column {
    Column { name: "x", sql: "x", kind, required, derived: false, about: "" }
}

#[test]
fn a_value_of_another_kind_than_its_column_is_refused() {
    for (value, kind) in [
        (ValueRef::Text(b"7"), Kind::Int),
        (ValueRef::Real(7.0), Kind::Int),
        (ValueRef::Integer(7), Kind::Real),
        (ValueRef::Integer(2), Kind::Bool),
        (ValueRef::Integer(-1), Kind::Bool),
        (ValueRef::Integer(7), Kind::Text),
        (ValueRef::Text(&[0xff, 0xfe]), Kind::Text),
        (ValueRef::Blob(b"text"), Kind::Text),
        (ValueRef::Text(b"yesterday"), Kind::Stamp),
        (ValueRef::Text(b"2026-02-29 00:00:00"), Kind::Stamp),
        (ValueRef::Integer(0), Kind::Stamp),
        (ValueRef::Text(b"2026-11-21 00:00:00"), Kind::Micros),
        (ValueRef::Integer(i64::MAX / 1000), Kind::Minute),
    ] {
        assert_eq!(Cell::read(value, &column(kind, false), None), None, "{value:?} as {kind:?}");
        assert_eq!(Cell::read(ValueRef::Null, &column(kind, true), None), None, "none as {kind:?}");
        assert_eq!(Cell::read(ValueRef::Null, &column(kind, false), None), Some(Cell::Null));
    }
}

#[test]
fn times_come_back_as_the_text_and_the_minute_that_they_were() {
    for text in [
        "1970-01-01 00:00:00.000000",
        "1969-12-31 23:59:59.999999",
        "2028-02-29 23:59:59.999999",
        "2016-12-31 23:59:59.000001",
        "2100-03-01 12:00:00.500000",
    ] {
        let cell = Cell::read(ValueRef::Text(text.as_bytes()), &column(Kind::Stamp, true), None).unwrap();
        let back = cell.to_sql(Kind::Stamp).unwrap();
        assert!(matches!(&back, ToSqlOutput::Owned(Value::Text(back)) if back == text), "{text}: {back:?}");
    }
    for minute in [-1, 0, 1, 29_921_040] {
        let cell = Cell::read(ValueRef::Integer(minute), &column(Kind::Minute, true), None).unwrap();
        let back = cell.to_sql(Kind::Minute).unwrap();
        assert!(matches!(back, ToSqlOutput::Owned(Value::Integer(back)) if back == minute), "{minute}");
    }
}

/// Rows are merged in the order in which SQLite gives them: where ours were another one, a row would be doubled.
#[test]
fn keys_have_the_order_of_sqlite() {
    let connection = Connection::open_in_memory().unwrap();
    connection.execute_batch("CREATE TABLE t (text TEXT, int INTEGER, real REAL)").unwrap();
    let texts = ["", "a", "B", "b", "é", "Z", "ab", "a b", "a-1", "10", "9", "\u{ffff}", "\u{1f52d}"];
    let numbers = [0, -1, 1, 9, 10, i64::MIN, i64::MAX];
    let reals = [0.0, -1.5, 1.5, 1e-300, f64::INFINITY, f64::NEG_INFINITY, f64::MAX];
    for text in texts {
        connection.execute("INSERT INTO t (text) VALUES (?)", [text]).unwrap();
    }
    for (int, real) in numbers.into_iter().zip(reals) {
        connection.execute("INSERT INTO t (int, real) VALUES (?, ?)", (int, real)).unwrap();
    }
    for (name, kind) in [("text", Kind::Text), ("int", Kind::Int), ("real", Kind::Real)] {
        let mut statement = connection.prepare(&format!("SELECT {name} FROM t ORDER BY {name}")).unwrap();
        let mut rows = statement.query([]).unwrap();
        let mut cells = Vec::new();
        while let Some(row) = rows.next().unwrap() {
            cells.push(Cell::read(row.get_ref(0).unwrap(), &column(kind, false), None).unwrap());
        }
        assert_eq!(cells.len(), texts.len() + numbers.len());
        for pair in cells.windows(2) {
            let is_same = pair[0] == pair[1];
            assert_eq!(pair[0].order(&pair[1]), if is_same { Ordering::Equal } else { Ordering::Less }, "{pair:?}");
        }
    }
}
