//! What was polled: around an instant, value by value, and drawn with few points over any time.

use contract::archive::{ArchiveRow, Gap, MOST_PROPERTIES, Series, SeriesName, SeriesPoint};
use contract::{Device, Scalar};
use rusqlite::{ToSql, params};
use units::Utc;

use super::Reader;
use crate::database::{DatabaseError, MINUTE_US, scalar};
use crate::interpolate::{Around, Rest, Sample};

/// Points of one answer, all properties together.
const MOST_POINTS: usize = 30_000;
/// Pieces of time from this length on are made of minutes; shorter ones of the values themselves.
const SHORTEST_OF_MINUTES_US: i64 = 15_000_000;
/// Times beyond are taken as this, so that differences of two are numbers: some 70,000 years from 1970.
const FARTHEST_US: i64 = i64::MAX / 4;
/// A time without a value is a gap if it is so many times what is usual between two values.
const GAP: i64 = 3;

/// What a row of a table adds to a point.
struct Piece {
    at_us: i64,
    /// Of its last value.
    last_us: i64,
    values: i64,
    minimum: Option<f64>,
    mean: Option<f64>,
    maximum: Option<f64>,
    last: Option<Scalar>,
}

impl Reader {
    /// The polls of a property around an instant; what is known of its device's moves is not looked for.
    pub fn around(&self, device: &Device, property: &str, at: Utc) -> Result<Around, DatabaseError> {
        let Some(series) = self.series_of(device, property)? else { return Ok(Around::default()) };
        let find = |condition: &str| self.samples(condition, params![series, at.micros()]);
        let before = find("at_us < ?2 AND value_type <> 0 AND value IS NOT NULL ORDER BY at_us DESC LIMIT 2")?;
        let after = find("at_us >= ?2 AND value_type <> 0 AND value IS NOT NULL ORDER BY at_us LIMIT 2")?;
        let received = "SELECT EXISTS (SELECT 1 FROM samples WHERE series = ? AND at_us >= ?)";
        let is_received = || self.list(received, params![series, at.micros()], |row| row.get::<_, bool>(0));
        let received_since = !after.is_empty() || is_received()?.contains(&true);
        Ok(Around { before, after, received_since, rest: Rest::default() })
    }

    /// The polls of a property in a time, in its order, each with its value where it had one; with the last value before
    /// and the first poll behind.
    pub fn polls(
        &self,
        device: &Device,
        property: &str,
        (from, to): (Utc, Utc),
    ) -> Result<Vec<(Utc, Option<Scalar>)>, DatabaseError> {
        let Some(series) = self.series_of(device, property)? else { return Ok(Vec::new()) };
        let sql = "SELECT at_us, value_type, value FROM samples WHERE series = ?1
            AND at_us >= ifnull((SELECT max(at_us) FROM samples
                WHERE series = ?1 AND at_us < ?2 AND value_type <> 0 AND value IS NOT NULL), ?2)
            AND at_us <= ifnull((SELECT min(at_us) FROM samples WHERE series = ?1 AND at_us > ?3), ?3) ORDER BY at_us";
        self.list(sql, params![series, from.micros(), to.micros()], |row| {
            Ok((Utc::from_micros(row.get(0)?), scalar(row, 1, 2)?))
        })
    }

    /// The number of the series of a device's property.
    fn series_of(&self, device: &Device, property: &str) -> Result<Option<i64>, DatabaseError> {
        let sql = "SELECT id FROM series
                   WHERE device_type = ? AND device_name = ? AND device_command = ? AND telescope = ?";
        let name = params![device.kind.ascom(), device.name.as_str(), property, device.address.telescope.as_str()];
        Ok(self.list(sql, name, |row| row.get(0))?.pop())
    }

    /// The values of a series, by a condition on them; the series is the first parameter.
    fn samples(&self, condition: &str, of: &[&dyn ToSql]) -> Result<Vec<Sample>, DatabaseError> {
        let sql = format!("SELECT at_us, value_type, value FROM samples WHERE series = ?1 AND {condition}");
        let samples = self.list(&sql, of, |row| {
            let at = Utc::from_micros(row.get(0)?);
            Ok(scalar(row, 1, 2)?.map(|value| Sample { at, value }))
        })?;
        Ok(samples.into_iter().flatten().collect())
    }

    /// The newest values of a property in a time, the newest first.
    pub(super) fn readings(
        &self,
        property: &SeriesName,
        (from, to): (Option<Utc>, Option<Utc>),
        most: u32,
    ) -> Result<Vec<ArchiveRow>, DatabaseError> {
        let from = from.map_or(i64::MIN, Utc::micros);
        let to = to.map_or(i64::MAX, Utc::micros);
        let Some(series) = self.number(property)? else { return Ok(Vec::new()) };
        let sql = "SELECT at_us, value_type, value FROM samples WHERE series = ? AND at_us >= ? AND at_us < ?
                   ORDER BY at_us DESC LIMIT ?";
        self.list(sql, params![series, from, to, most], |row| {
            Ok(ArchiveRow::Reading { at_utc: Utc::from_micros(row.get(0)?), value: scalar(row, 1, 2)? })
        })
    }

    /// Properties drawn with at most so many points each; those that were drawn when time was over.
    pub(super) fn series(
        &self,
        properties: &[SeriesName],
        (from, to): (Utc, Utc),
        points: u32,
        now: Utc,
    ) -> Result<Vec<ArchiveRow>, DatabaseError> {
        let asked = &properties[..properties.len().min(MOST_PROPERTIES)];
        let points = (points as usize).clamp(1, MOST_POINTS / asked.len().max(1));
        let from_us = from.micros().clamp(-FARTHEST_US, FARTHEST_US);
        let to_us = to.micros().clamp(from_us, FARTHEST_US.max(from_us));
        // The future lacks nothing.
        let known_us = now.micros().clamp(from_us, to_us);
        let mut drawn = Vec::with_capacity(asked.len());
        for property in asked {
            let pieces = self.pieces(property, (from_us, to_us), points)?;
            if self.is_cut() {
                break;
            }
            drawn.push(ArchiveRow::Series(pieces.series(property, (from_us, known_us))));
        }
        Ok(drawn)
    }

    fn pieces(
        &self,
        property: &SeriesName,
        (from_us, to_us): (i64, i64),
        points: usize,
    ) -> Result<Pieces, DatabaseError> {
        let piece_us = (to_us - from_us).div_euclid(points as i64) + 1;
        let oldest = self.list("SELECT min(day) FROM days", params![], |row| row.get::<_, Option<i64>>(0))?;
        let values_from_us = oldest.first().copied().flatten().map_or(i64::MAX, |day| day * 1440 * MINUTE_US);
        let mut pieces = Pieces { piece_us, from_us, points: Vec::new(), times_us: Vec::new() };
        let number = self.number(property)?;
        if piece_us >= SHORTEST_OF_MINUTES_US || from_us < values_from_us {
            // A minute that has begun before the time asked for belongs to it.
            let longer_us = piece_us + MINUTE_US.div_euclid(points as i64);
            pieces.piece_us = (longer_us + MINUTE_US).div_euclid(MINUTE_US) * MINUTE_US;
            pieces.from_us = from_us.div_euclid(MINUTE_US) * MINUTE_US;
            self.read_minutes(number, (pieces.from_us, to_us), &mut pieces)?;
        } else {
            self.read_values(number, (from_us, to_us), points, &mut pieces)?;
        }
        Ok(pieces)
    }

    /// The number of a property's series: of this telescope, or of what the site shares.
    fn number(&self, property: &SeriesName) -> Result<Option<i64>, DatabaseError> {
        let sql = "SELECT id FROM series WHERE device_type = ? AND device_name = ? AND device_command = ?
                   AND telescope IN (?, 'shared') ORDER BY telescope = 'shared' LIMIT 1";
        let name = params![property.kind.ascom(), property.device, property.property, self.telescope];
        Ok(self.list(sql, name, |row| row.get(0))?.pop())
    }

    fn read_minutes(
        &self,
        series: Option<i64>,
        (from_us, to_us): (i64, i64),
        pieces: &mut Pieces,
    ) -> Result<(), DatabaseError> {
        let sql = "SELECT minute, polled - missing, minimum, mean, maximum, last, last_us FROM minutes
                   WHERE series = ? AND minute >= ? AND minute < ? AND polled > missing";
        let first = from_us.div_euclid(MINUTE_US);
        let end = (to_us + MINUTE_US - 1).div_euclid(MINUTE_US);
        self.each_row(sql, params![series, first, end], |row| {
            let minimum: Option<f64> = row.get(2)?;
            let last = if minimum.is_some() { None } else { row.get::<_, Option<String>>(5)?.map(Scalar::Text) };
            let at_us = row.get::<_, i64>(0)? * MINUTE_US;
            pieces.add(Piece {
                at_us,
                last_us: row.get::<_, Option<i64>>(6)?.unwrap_or(at_us),
                values: row.get(1)?,
                minimum,
                mean: row.get(3)?,
                maximum: row.get(4)?,
                last,
            });
            Ok(true)
        })
    }

    fn read_values(
        &self,
        series: Option<i64>,
        (from_us, to_us): (i64, i64),
        points: usize,
        pieces: &mut Pieces,
    ) -> Result<(), DatabaseError> {
        let sql = "SELECT at_us, value_type, value FROM samples
                   WHERE series = ? AND at_us >= ? AND at_us < ? AND value_type <> 0";
        let values = self.list(sql, params![series, from_us, to_us], |row| Ok((row.get(0)?, scalar(row, 1, 2)?)))?;
        let values: Vec<(i64, Scalar)> =
            values.into_iter().filter_map(|(at_us, value)| Some((at_us, value?))).collect();
        if values.len() <= points {
            pieces.piece_us = 0;
        }
        for (at_us, value) in values {
            let number = match &value {
                Scalar::Bool(value) => Some(f64::from(u8::from(*value))),
                Scalar::Int(value) => Some(*value as f64),
                Scalar::Float(value) => Some(*value),
                Scalar::Text(_) | Scalar::List(_) => None,
            };
            let last = if number.is_some() { None } else { Some(value) };
            pieces.add(Piece {
                at_us,
                last_us: at_us,
                values: 1,
                minimum: number,
                mean: number,
                maximum: number,
                last,
            });
        }
        Ok(())
    }
}

/// Points that are being put together from rows in the order of time.
struct Pieces {
    /// Length of a piece; 0 where each row is a point.
    piece_us: i64,
    from_us: i64,
    points: Vec<SeriesPoint>,
    /// When each row's values begin, and when they end.
    times_us: Vec<(i64, i64)>,
}

impl Pieces {
    fn add(&mut self, row: Piece) {
        self.times_us.push((row.at_us, row.last_us));
        let begin_us = self.begin_us(row.at_us);
        let values = row.values.unsigned_abs();
        let at_utc = Utc::from_micros(begin_us);
        match self.points.last_mut().filter(|last| self.piece_us > 0 && last.at_utc == at_utc) {
            None => {
                let Piece { minimum: min, mean, maximum: max, last, .. } = row;
                self.points.push(SeriesPoint { at_utc, count: values, min, mean, max, last });
            }
            Some(point) => {
                let total = (point.count + values) as f64;
                point.mean = match (point.mean, row.mean) {
                    (Some(old), Some(new)) => Some((old * point.count as f64 + new * values as f64) / total),
                    (old, new) => old.or(new),
                };
                point.min = least(point.min, row.minimum);
                point.max = least(point.max.map(|max| -max), row.maximum.map(|max| -max)).map(|max| -max);
                point.last = row.last.or(point.last.take());
                point.count += values;
            }
        }
    }

    /// When the piece begins that has an instant.
    fn begin_us(&self, at_us: i64) -> i64 {
        match self.piece_us {
            0 => at_us,
            piece_us => self.from_us + (at_us - self.from_us) / piece_us * piece_us,
        }
    }

    fn series(mut self, property: &SeriesName, ends_us: (i64, i64)) -> Series {
        let gaps = self.gaps(ends_us);
        for gap in &gaps {
            // No point is in a gap: that of a piece into which one reaches is where its values begin.
            let begin_utc = Utc::from_micros(self.begin_us(gap.to_utc.micros()));
            let point = self.points.binary_search_by_key(&begin_utc, |point| point.at_utc);
            if let Some(point) = point.ok().and_then(|index| self.points.get_mut(index)) {
                point.at_utc = gap.to_utc;
            }
        }
        Series { property: property.clone(), piece_s: self.piece_us as f64 / 1e6, points: self.points, gaps }
    }

    /// The times without a value.
    fn gaps(&self, (from_us, to_us): (i64, i64)) -> Vec<Gap> {
        let mut between: Vec<i64> = self.times_us.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        let middle = between.len() / 2;
        let usual_us = if between.is_empty() { MINUTE_US } else { *between.select_nth_unstable(middle).1 };
        // Where there is nothing, everything is a gap.
        let limit_us = if self.times_us.is_empty() { 0 } else { (GAP * usual_us).max(self.piece_us) };
        let (mut gaps, mut since_us) = (Vec::new(), from_us);
        for (first_us, last_us) in self.times_us.iter().copied().chain([(to_us, to_us)]) {
            if first_us - since_us > limit_us {
                gaps.push(Gap { from_utc: Utc::from_micros(since_us), to_utc: Utc::from_micros(first_us) });
            }
            since_us = last_us;
        }
        gaps
    }
}

fn least(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}
