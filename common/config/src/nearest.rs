//! The known word that a misspelt one was probably meant to be.

/// A longer word is no slip of any.
const LONGEST: usize = 64;

/// The nearest of the known words, if it is near at all.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if word.len() > LONGEST {
        return None;
    }
    // by the share of letters that differ, so that an abbreviation finds its long word
    let share = |other: &str| {
        let longest = word.chars().count().max(other.chars().count()).max(1);
        (1000 * distance(word, other)).div_ceil(longest)
    };
    let (share, found) = known.into_iter().map(|other| (share(other), other)).min_by_key(|(share, _)| *share)?;
    (share <= 500).then_some(found)
}

/// What somebody probably meant, or all that there is.
pub fn meant<'a>(word: &str, known: impl IntoIterator<Item = &'a str> + Clone) -> String {
    match nearest(word, known.clone()) {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => {
            let all: Vec<&str> = known.into_iter().collect();
            format!("expected one of {}", all.join(", "))
        }
    }
}

/// Letters to change, add or drop between two words, without regard to case.
pub fn distance(a: &str, b: &str) -> usize {
    strsim::levenshtein(&a.to_lowercase(), &b.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_finds_its_word_and_nonsense_finds_none() {
        let known = ["object", "exptime", "guiding", "pointing"];
        assert_eq!(nearest("guidng", known), Some("guiding"));
        assert_eq!(nearest("ExpTime", known), Some("exptime"));
        assert_eq!(nearest("lat_deg", ["site", "dut1_s", "latitude_deg"]), Some("latitude_deg"));
        assert_eq!(nearest("zzzzzzzzzzzz", known), None);
    }
}
