//! Times as people and other programs write them into schedules; the predecessor reads all of these.

use units::Utc;

/// A time of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Read {
    /// The instant.
    pub utc: Utc,
    /// Day and month could be the other way round; the month was taken first, as the predecessor does.
    pub is_ambiguous: bool,
}

const MONTHS: [&str; 12] = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
const DAY_S: f64 = 86_400.0;

/// Reads a date and a time of day in one of the usual orders, with or without a zone; without one it is UTC.
pub fn read(text: &str) -> Option<Read> {
    let text = text.trim().trim_matches('\u{feff}');
    if let Ok(utc) = text.parse() {
        return Some(Read { utc, is_ambiguous: false });
    }
    let (text, offset_min) = without_zone(text)?;
    let (date, time) = match text.find(':').or_else(|| text.rfind(' ')) {
        // The hour is before the first colon.
        Some(_) => {
            let at = text.char_indices().find(|(at, c)| (*c == ' ' || *c == 'T') && is_time(text.get(at + 1..)));
            let at = at.map_or(text.len(), |(at, _)| at);
            (text.get(..at)?, text.get(at + 1..).unwrap_or("00:00"))
        }
        None => (text, "00:00"),
    };
    let ((year, month, day), is_ambiguous) = date_of(date.trim())?;
    let day_s = time_of(time.trim())?;
    let midnight: Utc = format!("{year:04}-{month:02}-{day:02}T00:00:00Z").parse().ok()?;
    Some(Read { utc: midnight.plus_seconds(day_s - 60.0 * f64::from(offset_min)), is_ambiguous })
}

fn is_time(text: Option<&str>) -> bool {
    text.is_some_and(|text| time_of(text.trim()).is_some())
}

/// The text without its zone, and the zone in minutes east.
fn without_zone(text: &str) -> Option<(&str, i32)> {
    for zone in ["UTC", "utc", "GMT", "Z", "z", "UT"] {
        if let Some(rest) = text.strip_suffix(zone) {
            return Some((rest.trim_end(), 0));
        }
    }
    // After the time of day only: dates have hyphens of their own.
    let Some(from) = text.find(':') else { return Some((text, 0)) };
    let Some(at) = text.get(from..)?.find(['+', '-']).map(|at| from + at) else { return Some((text, 0)) };
    let (rest, zone) = text.split_at(at);
    let digits: String = zone.chars().filter(char::is_ascii_digit).collect();
    let (hours, minutes): (i32, i32) = match digits.len() {
        1 | 2 => (digits.parse().ok()?, 0),
        4 => (digits.get(..2)?.parse().ok()?, digits.get(2..)?.parse().ok()?),
        _ => return None,
    };
    let sign = if zone.starts_with('-') { -1 } else { 1 };
    Some((rest.trim_end(), sign * (60 * hours + minutes)))
}

/// Year, month and day, and whether the last two could be meant the other way round.
fn date_of(date: &str) -> Option<((i32, u32, u32), bool)> {
    let parts: Vec<&str> = date.split(['-', '/', '.', ' ', ',']).filter(|part| !part.is_empty()).collect();
    let number = |part: &str| -> Option<u32> { part.parse().ok() };
    let is_year = |part: &str| part.len() == 4 && number(part).is_some();
    let month_named = |part: &str| {
        let start = part.get(..3)?.to_ascii_lowercase();
        let known = MONTHS.iter().position(|month| *month == start)?;
        Some(known as u32 + 1)
    };
    let (year, month, day, is_ambiguous) = match parts.as_slice() {
        [whole] if whole.len() == 8 => (whole.get(..4)?, number(whole.get(4..6)?)?, number(whole.get(6..)?)?, false),
        [year, month, day] if is_year(year) => {
            (*year, month_named(month).or_else(|| number(month))?, number(day)?, false)
        }
        [a, b, year] if is_year(year) => match (month_named(a), month_named(b)) {
            (Some(month), _) => (*year, month, number(b)?, false),
            (None, Some(month)) => (*year, month, number(a)?, false),
            (None, None) => {
                let (first, second) = (number(a)?, number(b)?);
                match first {
                    13.. => (*year, second, first, false),
                    _ => (*year, first, second, second <= 12 && first != second),
                }
            }
        },
        _ => return None,
    };
    let fits = (1..=12).contains(&month) && (1..=31).contains(&day);
    fits.then_some(((year.parse().ok()?, month, day), is_ambiguous))
}

/// Seconds since midnight.
fn time_of(time: &str) -> Option<f64> {
    let lower = time.to_ascii_lowercase();
    let (digits, after_noon) = match (lower.strip_suffix("am"), lower.strip_suffix("pm")) {
        (Some(digits), _) => (digits.trim(), Some(false)),
        (_, Some(digits)) => (digits.trim(), Some(true)),
        _ => (lower.as_str(), None),
    };
    let parts: Vec<&str> = digits.split(':').collect();
    let number = |part: &str| -> Option<f64> {
        let is_plain = !part.is_empty() && part.chars().all(|c| c.is_ascii_digit() || c == '.');
        if is_plain { part.parse().ok() } else { None }
    };
    let (hours, minutes, seconds) = match parts.as_slice() {
        [hours, minutes] => (number(hours)?, number(minutes)?, 0.0),
        [hours, minutes, seconds] => (number(hours)?, number(minutes)?, number(seconds)?),
        _ => return None,
    };
    let hours = match after_noon {
        Some(after) if (1.0..=12.0).contains(&hours) => hours % 12.0 + if after { 12.0 } else { 0.0 },
        Some(_) => return None,
        None => hours,
    };
    let day_s = 3600.0 * hours + 60.0 * minutes + seconds;
    (minutes < 60.0 && seconds < 61.0 && day_s < DAY_S).then_some(day_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_read_in_the_ways_that_people_write_it() {
        for text in [
            "2026-11-23 01:02:03 UTC",
            "23.11.2026 01:02:03",
            "2026/11/23 01:02:03",
            "11/23/2026 01:02:03 AM",
            "20261123T01:02:03Z",
            "2026-11-23T03:02:03 +02:00",
            "2026-11-22 20:02:03 -0500",
            "23 Nov 2026 01:02:03",
            "November 23, 2026 01:02:03 GMT",
        ] {
            let read = read(text).unwrap_or_else(|| panic!("{text}"));
            assert_eq!(
                (read.utc.to_string(), read.is_ambiguous),
                ("2026-11-23T01:02:03.000000Z".to_owned(), false),
                "{text}"
            );
        }
        let odd = read("03.04.2026 12:00").unwrap();
        assert_eq!((odd.utc.to_string().get(..10), odd.is_ambiguous), (Some("2026-03-04"), true));
        assert_eq!(read("23.11.2026").map(|read| read.utc.seconds().rem_euclid(DAY_S)), Some(0.0));
        for text in ["", "tonight", "25:00", "2026-13-01 00:00", "32.11.2026 01:00", "2026-11-23 24:30", "1", "é:é +é"]
        {
            assert_eq!(read(text), None, "{text}");
        }
    }
}
