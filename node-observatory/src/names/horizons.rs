//! JPL's Horizons: osculating elements of asteroids and comets for a day.

use schedule::names::Meaning;
use units::Utc;

use super::http::encoded;

/// The question for a small body's elements about the Sun at an instant. The semicolon asks for small bodies only.
pub fn question(base: &str, name: &str, at: Utc) -> String {
    let target = format!("'{};'", name.trim().trim_end_matches(';'));
    let when = format!("'{:.1}'", at.jd());
    let parameters = [
        ("format", "text"),
        ("COMMAND", target.as_str()),
        ("OBJ_DATA", "'NO'"),
        ("MAKE_EPHEM", "'YES'"),
        ("EPHEM_TYPE", "'ELEMENTS'"),
        ("CENTER", "'500@10'"),
        ("TLIST", when.as_str()),
        ("OUT_UNITS", "'AU-D'"),
        ("REF_PLANE", "'ECLIPTIC'"),
        ("REF_SYSTEM", "'ICRF'"),
        ("TP_TYPE", "'ABSOLUTE'"),
        ("CSV_FORMAT", "'YES'"),
    ];
    let parameters: Vec<String> = parameters.iter().map(|(key, value)| format!("{key}={}", encoded(value))).collect();
    format!("{base}?{}", parameters.join("&"))
}

/// The content of the answer; `None`: no small body has this name.
///
/// # Errors
/// When several have it, or the answer is none of Horizons'.
pub fn read(answer: &str) -> Result<Option<Meaning>, String> {
    let Some(table) = answer.split_once("$$SOE").map(|(_, rest)| rest) else {
        let lower_case = answer.to_lowercase();
        if lower_case.contains("no matches found") {
            return Ok(None);
        }
        if lower_case.contains("matching small-bodies") || lower_case.contains("multiple") {
            return Err("several small bodies have that name: give a designation, or a number".to_owned());
        }
        return Err("the answer is none of Horizons'".to_owned());
    };
    let row = table.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default();
    // JD, date, EC, QR, IN, OM, W, Tp, ...
    let cells: Vec<&str> = row.split(',').map(str::trim).collect();
    let number = |index: usize| {
        let number = cells.get(index).and_then(|cell| cell.parse::<f64>().ok()).filter(|number| number.is_finite());
        number.ok_or_else(|| format!("the answer has no elements: {}", row.chars().take(80).collect::<String>()))
    };
    Ok(Some(Meaning::Orbit {
        epoch_jd: number(0)?,
        e: number(2)?,
        q_au: number(3)?,
        i_deg: number(4)?,
        node_deg: number(5)?,
        peri_deg: number(6)?,
        tp_jd: number(7)?,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The form of a real answer, with the numbers of Ceres.
    const CERES: &str = "Target body name: 1 Ceres (A801 AA)               {source: JPL#48}\n\
        ****\n            JDTDB,            Calendar Date (TDB),   EC,  QR,  IN,  OM,   W,  Tp,  N,  MA,  TA,  A,  AD,  PR,\n\
        ****\n$$SOE\n2459740.500000000, A.D. 2022-Jun-10 00:00:00.0000,  7.857509431507990E-02,  2.549012173144731E+00,  \
        1.058712597794349E+01,  8.026775296710701E+01,  7.356968535036279E+01,  2.459920525171203E+06,  \
        2.142082187859277E-01,  3.214371287399738E+02,  3.153704983697174E+02,  2.766380805878023E+00,\n$$EOE\n****\n";

    #[test]
    fn elements_are_read_from_their_columns() {
        let Ok(Some(Meaning::Orbit { q_au, e, tp_jd, epoch_jd, i_deg, .. })) = read(CERES) else { panic!() };
        assert_eq!((q_au, e, i_deg), (2.549012173144731, 0.0785750943150799, 10.58712597794349));
        assert_eq!((tp_jd, epoch_jd), (2459920.525171203, 2459740.5));
        let asked = question("https://x.org/api", "Ceres", "2022-06-10T00:00:00Z".parse().unwrap());
        assert!(asked.starts_with("https://x.org/api?format=text&COMMAND=%27Ceres%3B%27&"), "{asked}");
        assert!(asked.contains("TLIST=%272459740.5%27"), "{asked}");
    }

    #[test]
    fn an_unknown_name_is_none_and_an_unclear_or_strange_answer_a_fault() {
        assert_eq!(read("\n No matches found.\n"), Ok(None));
        assert!(read("Matching small-bodies: \n 1P ... 2P").unwrap_err().contains("several"));
        assert!(read("$$SOE\nnonsense\n$$EOE").is_err());
        assert!(read("<html></html>").is_err());
    }
}
