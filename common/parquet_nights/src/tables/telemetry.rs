//! Telemetry: each value, and each minute.

use super::{given, maybe};
use crate::table::{Column, Kind, Table};

/// The parts of a series' name, which is made before its rows.
const PUT_SERIES: &str = "INSERT OR IGNORE INTO series (device_type, device_name, device_command, telescope)
    VALUES (?1, ?2, ?3, ?4)";

const VALUES: &[Column] = &[
    given("device_type", Kind::Text, "ASCOM's name of the kind of device, such as `ObservingConditions`"),
    given("device_name", Kind::Text, "the device, by its name in `observatory.toml`"),
    given("property", Kind::Text, "ASCOM's name of the property").read_by("device_command"),
    given("device_telescope", Kind::Text, "the telescope that the device belongs to; `shared` for a device of the site").read_by("telescope"),
    given("polled_at", Kind::Micros, "when it was polled").read_by("at_us"),
    given("value_type", Kind::Text, "`bool`, `int`, `float`, `text`, `list`; `none` where the device had no value").read_by("CASE value_type WHEN 1 THEN 'bool' WHEN 2 THEN 'int' WHEN 3 THEN 'float' WHEN 4 THEN 'text' WHEN 5 THEN 'list' ELSE 'none' END"),
    maybe("number", Kind::Real, "the value of `bool` (0 or 1), `int` and `float`; none for NaN").read_by("CASE WHEN typeof(value) IN ('integer', 'real') THEN CAST(value AS REAL) END"),
    maybe("integer", Kind::Int, "the exact value of `bool` and `int`").read_by("CASE typeof(value) WHEN 'integer' THEN value END"),
    maybe("text", Kind::Text, "the value of `text`, and of `list` as JSON").read_by("CASE WHEN value_type IN (4, 5) THEN value END"),
    maybe("reason", Kind::Text, "why there was no value").read_by("CASE value_type WHEN 0 THEN value END"),
];

/// Each polled value.
pub(super) const TELEMETRY: Table = Table {
    name: "telemetry",
    about: "each polled value",
    columns: VALUES,
    key: 5,
    group: 2,
    prefer: None,
    // The order of the joins makes the index on the names of series give the order of the rows.
    from: "series CROSS JOIN samples ON samples.series = series.id AND at_us >= :from_us AND at_us < :to_us
        WHERE telescope IN (:telescope, 'shared')",
    // A value of the seconds between noon and the next minute is in a minute of the night before.
    next: Some(
        "SELECT min((SELECT at_us FROM samples WHERE samples.series = series.id
            AND at_us >= :from_us ORDER BY at_us LIMIT 1))
            FROM series WHERE telescope IN (:telescope, 'shared')",
    ),
    insert: Some(
        "INSERT OR REPLACE INTO samples SELECT id, ?5, CASE ?6 WHEN 'bool' THEN 1 WHEN 'int' THEN 2 WHEN 'float' THEN 3
            WHEN 'text' THEN 4 WHEN 'list' THEN 5 ELSE 0 END, coalesce(?8, ?7, ?9, ?10)
            FROM series WHERE device_type = ?1 AND device_name = ?2 AND device_command = ?3 AND telescope = ?4",
    ),
    into: "samples",
    owner: None,
    before: Some(PUT_SERIES),
};

const MINUTE_COLUMNS: &[Column] = &[
    given("device_type", Kind::Text, "ASCOM's name of the kind of device, such as `ObservingConditions`"),
    given("device_name", Kind::Text, "the device, by its name in `observatory.toml`"),
    given("property", Kind::Text, "ASCOM's name of the property").read_by("device_command"),
    given(
        "device_telescope",
        Kind::Text,
        "the telescope that the device belongs to; `shared` for a device of the site",
    )
    .read_by("telescope"),
    given("minute", Kind::Minute, "when the minute began"),
    given("polled", Kind::Int, "how many values were polled"),
    given("missing", Kind::Int, "how many of them were none"),
    maybe("minimum", Kind::Real, "the smallest number (true and false count as 1 and 0)"),
    maybe("mean", Kind::Real, "the mean of the numbers"),
    maybe("maximum", Kind::Real, "the largest number"),
    maybe("last_at", Kind::Micros, "when the last value was polled").read_by("last_us"),
    maybe("last_number", Kind::Real, "the last value, if it is a number")
        .read_by("CASE WHEN typeof(last) IN ('integer', 'real') THEN CAST(last AS REAL) END"),
    maybe("last_integer", Kind::Int, "the last value exactly, if it is an integer")
        .read_by("CASE typeof(last) WHEN 'integer' THEN last END"),
    maybe("last_text", Kind::Text, "the last value, if it is a text or a list")
        .read_by("CASE typeof(last) WHEN 'text' THEN last END"),
];

/// Each minute of each series.
pub(super) const MINUTES: Table = Table {
    name: "minutes",
    about: "each minute in which a property was polled",
    columns: MINUTE_COLUMNS,
    key: 5,
    group: 2,
    prefer: Some("polled"),
    from: "series CROSS JOIN minutes ON minutes.series = series.id
        AND minute * 60000000 >= :from_us AND minute * 60000000 < :to_us
        AND minute >= :from_us / 60000000 - 1 AND minute <= :to_us / 60000000
        WHERE telescope IN (:telescope, 'shared')",
    next: Some(
        "SELECT min((SELECT minute * 60000000 FROM minutes WHERE minutes.series = series.id
            AND minute >= (:from_us + 59999999) / 60000000 ORDER BY minute LIMIT 1))
            FROM series WHERE telescope IN (:telescope, 'shared')",
    ),
    insert: Some(
        "INSERT OR REPLACE INTO minutes SELECT id, ?5, ?6, ?7, ?8, ?9, ?10, ?11, coalesce(?13, ?12, ?14)
            FROM series WHERE device_type = ?1 AND device_name = ?2 AND device_command = ?3 AND telescope = ?4",
    ),
    into: "minutes",
    owner: None,
    before: Some(PUT_SERIES),
};
