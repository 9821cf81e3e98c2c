//! Telemetry: each value once, under the number of its series, and for each minute what is kept for ever.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use contract::{Device, Scalar};
use rusqlite::types::{Value, ValueRef};
use rusqlite::{OptionalExtension as _, Transaction, params};
use units::Utc;

/// The addition of version 7. A value takes some 25 bytes instead of 250. Times are microseconds since 1970, and
/// `value_type` says how `value` is read: 0 no value (`value` is the reason), 1 true or false, 2 integer, 3 number,
/// 4 text, 5 list as JSON.
///
/// `minutes` has a row for each minute (since 1970) in which a series was polled; minimum, mean and maximum of numbers,
/// and of true and false as 1 and 0. `days` lists the days (since 1970) of which values are kept.
///
/// The view `polling` is the predecessor's table of before.
pub(super) const SCHEMA: &str = "
CREATE TABLE series (
    id INTEGER PRIMARY KEY, telescope TEXT NOT NULL, device_type TEXT NOT NULL, device_name TEXT NOT NULL,
    device_command TEXT NOT NULL, UNIQUE (device_type, device_name, device_command, telescope)
);
CREATE TABLE samples (
    series INTEGER NOT NULL, at_us INTEGER NOT NULL, value_type INTEGER NOT NULL, value,
    PRIMARY KEY (series, at_us)
) WITHOUT ROWID;
CREATE TABLE minutes (
    series INTEGER NOT NULL, minute INTEGER NOT NULL, polled INTEGER NOT NULL, missing INTEGER NOT NULL,
    minimum REAL, mean REAL, maximum REAL, last_us INTEGER, last,
    PRIMARY KEY (series, minute)
) WITHOUT ROWID;
CREATE TABLE days (day INTEGER PRIMARY KEY);
INSERT INTO series (telescope, device_type, device_name, device_command)
    SELECT DISTINCT telescope, device_type, device_name, device_command FROM polling;
INSERT OR IGNORE INTO samples
    SELECT series.id,
        CAST(strftime('%s', substr(datetime, 1, 19)) AS INTEGER) * 1000000 + CAST(substr(datetime, 21, 6) AS INTEGER),
        CASE value_type WHEN 'bool' THEN 1 WHEN 'int' THEN 2 WHEN 'float' THEN 3 WHEN 'text' THEN 4 WHEN 'list' THEN 5 ELSE 0 END,
        CASE value_type WHEN 'bool' THEN device_value = 'True' WHEN 'int' THEN CAST(device_value AS INTEGER)
            WHEN 'float' THEN CAST(device_value AS REAL) WHEN 'none' THEN no_data ELSE device_value END
    FROM polling JOIN series USING (telescope, device_type, device_name, device_command);
INSERT INTO minutes
    SELECT series, at_us / 60000000, count(*), sum(value_type = 0),
        min(CASE WHEN value_type IN (1, 2, 3) THEN value END), avg(CASE WHEN value_type IN (1, 2, 3) THEN value END),
        max(CASE WHEN value_type IN (1, 2, 3) THEN value END), NULL, NULL
    FROM samples GROUP BY series, at_us / 60000000;
UPDATE minutes SET (last_us, last) = (
    SELECT at_us, value FROM samples WHERE samples.series = minutes.series AND value_type <> 0
        AND at_us >= minute * 60000000 AND at_us < (minute + 1) * 60000000 ORDER BY at_us DESC LIMIT 1
);
INSERT INTO days SELECT DISTINCT minute / 1440 FROM minutes;
DROP TABLE polling;
CREATE VIEW polling AS
    SELECT device_type, device_name, device_command,
        CASE value_type WHEN 0 THEN NULL WHEN 1 THEN iif(value, 'True', 'False') ELSE CAST(value AS TEXT) END AS device_value,
        strftime('%Y-%m-%d %H:%M:%S', at_us / 1000000, 'unixepoch') || printf('.%06d', at_us % 1000000) AS datetime,
        CASE value_type WHEN 1 THEN 'bool' WHEN 2 THEN 'int' WHEN 3 THEN 'float' WHEN 4 THEN 'text' WHEN 5 THEN 'list'
            ELSE 'none' END AS value_type,
        iif(value_type = 0, value, NULL) AS no_data, telescope
    FROM samples JOIN series ON series.id = samples.series;
";

/// Microseconds of a minute, and of a day.
pub(crate) const MINUTE_US: i64 = 60_000_000;
const DAY_US: i64 = MINUTES_OF_A_DAY * MINUTE_US;
const MINUTES_OF_A_DAY: i64 = 1440;

const PUT_SAMPLE: &str = "INSERT INTO samples VALUES (?,?,?,?) ON CONFLICT DO NOTHING";

/// A minute gets what a batch adds to it.
const PUT_MINUTE: &str = "
INSERT INTO minutes VALUES (?,?,?,?,?,?,?,?,?) ON CONFLICT (series, minute) DO UPDATE SET
    polled = polled + excluded.polled,
    missing = missing + excluded.missing,
    minimum = min(ifnull(minimum, excluded.minimum), ifnull(excluded.minimum, minimum)),
    mean = CASE WHEN mean IS NULL THEN excluded.mean WHEN excluded.mean IS NULL THEN mean
        ELSE (mean * (polled - missing) + excluded.mean * (excluded.polled - excluded.missing))
            / (polled - missing + excluded.polled - excluded.missing) END,
    maximum = max(ifnull(maximum, excluded.maximum), ifnull(excluded.maximum, maximum)),
    last = iif(ifnull(excluded.last_us, 0) >= ifnull(last_us, 0), excluded.last, last),
    last_us = nullif(max(ifnull(excluded.last_us, 0), ifnull(last_us, 0)), 0)
";

const FIND_SERIES: &str = "
SELECT id FROM series WHERE device_type = ? AND device_name = ? AND device_command = ? AND telescope = ?
";
const PUT_SERIES: &str = "
INSERT INTO series (device_type, device_name, device_command, telescope) VALUES (?,?,?,?) ON CONFLICT DO NOTHING
";

/// What the table's column `value_type` says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum ValueType {
    /// No value.
    None = 0,
    /// True or false.
    Bool = 1,
    /// An integer.
    Int = 2,
    /// A number.
    Float = 3,
    /// Text.
    Text = 4,
    /// A list, as JSON.
    List = 5,
}

/// A value as its two columns hold it.
fn columns(value: &Result<Scalar, String>) -> rusqlite::Result<(ValueType, Value)> {
    Ok(match value {
        Err(reason) => (ValueType::None, Value::Text(reason.clone())),
        Ok(Scalar::Bool(value)) => (ValueType::Bool, Value::Integer((*value).into())),
        Ok(Scalar::Int(value)) => (ValueType::Int, Value::Integer(*value)),
        Ok(Scalar::Float(value)) => (ValueType::Float, Value::Real(*value)),
        Ok(Scalar::Text(value)) => (ValueType::Text, Value::Text(value.clone())),
        Ok(list @ Scalar::List(_)) => {
            let json = serde_json::to_string(list).map_err(|e| rusqlite::Error::ToSqlConversionFailure(Box::new(e)))?;
            (ValueType::List, Value::Text(json))
        }
    })
}

/// The value of the two columns; `None` where the device had none, or one that is no number: SQLite stores NaN as nothing.
pub(crate) fn scalar(row: &rusqlite::Row<'_>, value_type: usize, value: usize) -> rusqlite::Result<Option<Scalar>> {
    let known: i64 = row.get(value_type)?;
    if row.get_ref(value)? == ValueRef::Null {
        return Ok(None);
    }
    Ok(Some(match known {
        1 => Scalar::Bool(row.get(value)?),
        2 => Scalar::Int(row.get(value)?),
        3 => Scalar::Float(row.get(value)?),
        4 => Scalar::Text(row.get(value)?),
        5 => serde_json::from_str(row.get_ref(value)?.as_str()?)
            .map_err(|e| rusqlite::Error::FromSqlConversionFailure(value, rusqlite::types::Type::Text, Box::new(e)))?,
        _ => return Ok(None),
    }))
}

/// What a batch adds to a minute of a series.
#[derive(Debug, Default)]
struct Minute {
    polled: i64,
    missing: i64,
    minimum: Option<f64>,
    sum: f64,
    maximum: Option<f64>,
    last: Option<(i64, Value)>,
}

impl Minute {
    fn add(&mut self, at_us: i64, value_type: ValueType, value: Value) {
        self.polled += 1;
        if value_type == ValueType::None || matches!(value, Value::Real(number) if number.is_nan()) {
            self.missing += 1;
            return;
        }
        let number = match (value_type, &value) {
            (ValueType::Bool | ValueType::Int, Value::Integer(number)) => Some(*number as f64),
            (_, Value::Real(number)) => Some(*number),
            _ => None,
        };
        if let Some(number) = number {
            self.minimum = Some(self.minimum.map_or(number, |least| least.min(number)));
            self.maximum = Some(self.maximum.map_or(number, |most| most.max(number)));
            self.sum += number;
        }
        if self.last.as_ref().is_none_or(|(last_us, _)| *last_us <= at_us) {
            self.last = Some((at_us, value));
        }
    }
}

/// Values that go at once: a frame that waits for its row waits as long as this takes at most.
const MOST_FORGOTTEN: i64 = 20_000;

/// The writer's side: which number a series has, and what the batch that is being written adds to the minutes.
#[derive(Debug, Default)]
pub(super) struct Telemetry {
    series: HashMap<Device, HashMap<String, i64>>,
    minutes: BTreeMap<(i64, i64), Minute>,
}

impl Telemetry {
    /// Writes a value; returns 1 where it is new.
    pub(super) fn write(
        &mut self,
        transaction: &Transaction<'_>,
        (device, property): (&Device, &str),
        value: &Result<Scalar, String>,
        at: Utc,
    ) -> rusqlite::Result<usize> {
        let series = self.series(transaction, device, property)?;
        let (value_type, value) = columns(value)?;
        let at_us = at.micros();
        let new = transaction.prepare_cached(PUT_SAMPLE)?.execute(params![series, at_us, value_type as u8, value])?;
        if new > 0 {
            self.minutes.entry((series, at_us.div_euclid(MINUTE_US))).or_default().add(at_us, value_type, value);
        }
        Ok(new)
    }

    /// Writes what the batch adds to the minutes, before it is committed.
    pub(super) fn write_minutes(&mut self, transaction: &Transaction<'_>) -> rusqlite::Result<()> {
        let mut put = transaction.prepare_cached(PUT_MINUTE)?;
        let days: BTreeSet<i64> = self.minutes.keys().map(|(_, minute)| minute.div_euclid(MINUTES_OF_A_DAY)).collect();
        for day in days {
            transaction.prepare_cached("INSERT INTO days VALUES (?) ON CONFLICT DO NOTHING")?.execute([day])?;
        }
        for ((series, minute), added) in std::mem::take(&mut self.minutes) {
            let Minute { polled, missing, minimum, sum, maximum, last } = added;
            let mean = minimum.map(|_| sum / (polled - missing) as f64);
            let (last_us, last) = last.unzip();
            put.execute(params![series, minute, polled, missing, minimum, mean, maximum, last_us, last])?;
        }
        Ok(())
    }

    /// Removes some values of the days that are older than the newest `days`; their minutes stay. Days are counted
    /// only if something was polled: a clock that is years ahead for a while makes no value old.
    pub(super) fn forget_old(&mut self, transaction: &Transaction<'_>, days: u32) -> rusqlite::Result<()> {
        self.write_minutes(transaction)?;
        let oldest_day = "SELECT day FROM days ORDER BY day DESC LIMIT 1 OFFSET ?";
        let find = transaction.query_row(oldest_day, [i64::from(days) - 1], |row| row.get::<_, i64>(0)).optional();
        let Some(oldest_day) = find? else { return Ok(()) };
        let mut all = transaction.prepare_cached("SELECT id FROM series")?;
        let series = all.query_map([], |row| row.get(0))?.collect::<rusqlite::Result<Vec<i64>>>()?;
        let mut forget = transaction.prepare_cached(
            "DELETE FROM samples WHERE series = ?1 AND at_us IN (
                SELECT at_us FROM samples WHERE series = ?1 AND at_us < ?2 ORDER BY at_us LIMIT ?3)",
        )?;
        let mut left = MOST_FORGOTTEN;
        for series in series {
            left -= forget.execute(params![series, oldest_day * DAY_US, left])? as i64;
            if left == 0 {
                return Ok(());
            }
        }
        transaction.execute("DELETE FROM days WHERE day < ?", [oldest_day])?;
        Ok(())
    }

    fn series(&mut self, transaction: &Transaction<'_>, device: &Device, property: &str) -> rusqlite::Result<i64> {
        if let Some(id) = self.series.get(device).and_then(|known| known.get(property)) {
            return Ok(*id);
        }
        let name = params![device.kind.ascom(), device.name.as_str(), property, device.address.telescope.as_str()];
        let find = || transaction.query_row(FIND_SERIES, name, |row| row.get(0)).optional();
        let id = match find()? {
            Some(id) => id,
            None => {
                transaction.execute(PUT_SERIES, name)?;
                find()?.ok_or(rusqlite::Error::QueryReturnedNoRows)?
            }
        };
        self.series.entry(device.clone()).or_default().insert(property.to_owned(), id);
        Ok(id)
    }
}

#[cfg(test)]
#[path = "drawn_tests.rs"]
mod drawn_tests;

#[cfg(test)]
#[path = "telemetry_tests.rs"]
mod tests;
