//! Sesame, the name service of the CDS in Strasbourg: stars and everything beyond them.

use schedule::names::Meaning;

use super::http::encoded;

/// The question for a name. `-oI` asks for everything as lines, `A` for the first of SIMBAD, NED and VizieR that knows
/// it.
pub fn question(base: &str, name: &str) -> String {
    format!("{}/-oI/A?{}", base.trim_end_matches('/'), encoded(name))
}

/// The content of the answer; `None`: the name is not known there.
///
/// # Errors
/// When the answer is none of Sesame's.
pub fn read(answer: &str) -> Result<Option<Meaning>, String> {
    if !answer.lines().any(|line| line.starts_with("# ") || line.starts_with("#=")) {
        return Err("the answer is none of Sesame's".to_owned());
    }
    let two = |mark: &str| {
        let line = answer.lines().find_map(|line| line.strip_prefix(mark))?;
        let mut numbers = line.split_whitespace().map(str::parse::<f64>);
        Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
    };
    let Some((ra_deg, dec_deg)) = two("%J ") else { return Ok(None) };
    if !((0.0..=360.0).contains(&ra_deg) && dec_deg.abs() <= 90.0) {
        return Err(format!("the answer's place is none: {ra_deg} {dec_deg}"));
    }
    let (pm_ra_mas, pm_dec_mas) = two("%P ").filter(|(ra, dec)| ra.is_finite() && dec.is_finite()).unwrap_or_default();
    Ok(Some(Meaning::Fixed { ra_deg, dec_deg, pm_ra_mas, pm_dec_mas }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn place_and_proper_motion_are_read() {
        let answer = "# Vega\t#Q22523722\n#=S=Simbad (via url):    1     1ms\n%@ 2900717\n%C.0 dS*\n\
                      %J 279.23473479 +38.78368896 = 18 36 56.33635 +38 47 01.2802\n%P 200.94 286.23 [0.32 0.33 0] A\n\n";
        let expected =
            Meaning::Fixed { ra_deg: 279.23473479, dec_deg: 38.78368896, pm_ra_mas: 200.94, pm_dec_mas: 286.23 };
        assert_eq!(read(answer), Ok(Some(expected)));
        assert_eq!(question("https://x.org/sesame/", "M 31"), "https://x.org/sesame/-oI/A?M%2031");
    }

    #[test]
    fn an_unknown_name_is_none_and_a_strange_answer_a_fault() {
        assert_eq!(read("# Nonsuch\t#Q1\n#!SIMBAD: Nothing found\n"), Ok(None));
        assert!(read("<html>login</html>").is_err());
        assert!(read("").is_err());
        assert!(read("# x\n%J 500 +99\n").is_err());
        assert_eq!(read("# x\n%J nan\n"), Ok(None));
    }
}
