//! The keywords that facts make in a header.
//!
//! They are in the header of every measured frame, whether the site's table lists them or not. A table that takes one
//! of these keywords from elsewhere keeps it; one that lists it as computed (`astra`) chooses the comment.

use config::header::{HeaderTable, Source};
use contract::observatory::{FrameFacts, FrameWcs};

use crate::card::{Card, CardValue};
use crate::plan::Plan;

type FactValue = fn(&FrameFacts) -> Option<CardValue>;

/// Keyword, value and comment; units stand in brackets as the FITS standard 4.0, 4.3 has them.
const KEYWORDS: [(&str, FactValue, &str); 24] = [
    ("NSTARS", |f| Some(CardValue::Int(f.stars?.into())), "stars found"),
    ("FWHM", |f| f.fwhm_px.map(CardValue::Float), "[pix] median FWHM of the best stars, Moffat"),
    ("FWHMERR", |f| f.fwhm_error_px.map(CardValue::Float), "[pix] standard error of FWHM"),
    ("ELLIPTIC", |f| f.ellipticity.map(CardValue::Float), "1 - minor / major axis of the same stars"),
    ("ELONGPA", |f| f.elongation_deg.map(CardValue::Float), "[deg] direction of the stars, +x to +y"),
    ("TRAILED", |f| f.trailed.map(CardValue::Logical), "all stars are drawn out in one direction"),
    ("BKGLEVEL", |f| f.sky_adu.map(CardValue::Float), "[adu] median level of sky or frame"),
    ("BKGNOISE", |f| f.noise_adu.map(CardValue::Float), "[adu] noise of a pixel of it"),
    ("SATFRAC", |f| f.saturated_fraction.map(CardValue::Float), "share of saturated pixels, 0 to 1"),
    ("BADFRAC", |f| f.defect_fraction.map(CardValue::Float), "share of defect pixels, 0 to 1"),
    ("MAGZPT", |f| f.zero_point_mag.map(CardValue::Float), "[mag] of a star that gives 1 adu/s"),
    ("MAGZPERR", |f| f.zero_point_error_mag.map(CardValue::Float), "[mag] standard error of MAGZPT"),
    ("TRANSPAR", |f| f.transparency.map(CardValue::Float), "share of starlight that comes through"),
    ("DOMEHID", |f| f.dome_hid_percent.map(CardValue::Float), "percent of the light that the dome hid"),
    ("REFUSED", |f| f.refused.is_some().then_some(true.into()), "the frame does not count; HISTORY says why"),
    (
        "SOLVED",
        |f| (f.wcs.is_some() || f.unsolved.is_some()).then(|| f.wcs.is_some().into()),
        "a plate solution was found",
    ),
    ("PIXSCALE", |f| f.scale_arcsec_px.map(CardValue::Float), "[arcsec/pix] size of a pixel at the centre"),
    ("POSANGLE", |f| f.rotation_deg.map(CardValue::Float), "[deg] +y from north through east"),
    ("MIRRORED", |f| Some(is_mirrored(f.wcs.as_ref()?).into()), "det(CD) > 0, first row below: mirror image"),
    ("NMATCHED", |f| Some(CardValue::Int(f.matched?.into())), "stars that agree with the catalogue"),
    ("WCSRMS", |f| f.rms_px.map(CardValue::Float), "[pix] rms of their places"),
    ("WCSFALSE", |f| f.false_alarm.map(CardValue::Float), "probability of a false solution"),
    ("OFFTARG", |f| f.off_target_arcmin.map(CardValue::Float), "[arcmin] frame's middle to target"),
    ("TARGSAT", |f| f.target_saturated.map(CardValue::Logical), "the star of the target is saturated"),
];

/// Whether the sky is a mirror image as FITS counts pixels, with the first row at the bottom: north up, east on the right.
fn is_mirrored(wcs: &FrameWcs) -> bool {
    let [[a, b], [c, d]] = wcs.cd_deg_px;
    a * d - b * c > 0.0
}

/// The keywords that facts make, with their comments.
pub fn all() -> impl Iterator<Item = (&'static str, &'static str)> {
    KEYWORDS.iter().map(|(keyword, _, comment)| (*keyword, *comment))
}

/// How the lines of history begin that say why a frame was not measured, was not solved, or does not count.
const HISTORY: [&str; 3] = ["not measured: ", "not solved: ", "does not count: "];

/// The keyword that guiding makes, which is not in the facts of a frame.
pub const GUIDED: &str = "GUIDERMS";

/// Whether facts or guiding make this keyword.
pub fn makes(keyword: &str) -> bool {
    keyword == GUIDED || KEYWORDS.iter().any(|(known, ..)| *known == keyword)
}

/// The keywords that facts add to a header.
pub fn plan(table: &HeaderTable, facts: &FrameFacts) -> Plan {
    let card = |(keyword, value, comment): &(&str, FactValue, &str)| {
        let row = table.rows.iter().find(|row| row.keyword == *keyword);
        let comment = match row {
            None => comment,
            Some(row) if row.source == Source::Computed && row.comment.is_empty() => comment,
            Some(row) if row.source == Source::Computed => row.comment.as_str(),
            Some(_) => return None,
        };
        Some(Card::new(keyword, value(facts)?, comment))
    };
    let is_own = |keyword: &&str| {
        table.rows.iter().find(|row| row.keyword == **keyword).is_none_or(|row| row.source == Source::Computed)
    };
    let unsolved = facts.unsolved.as_ref().map(|unsolved| &unsolved.detail);
    let whys = [facts.reason.as_ref(), unsolved, facts.refused.as_ref()];
    let lines = HISTORY.iter().zip(whys).filter_map(|(begin, why)| Some(format!("{begin}{}", why?)));
    Plan {
        cards: KEYWORDS.iter().filter_map(card).collect(),
        history: lines.collect(),
        own_history: HISTORY.to_vec(),
        own_keywords: KEYWORDS.iter().map(|(keyword, ..)| *keyword).filter(is_own).collect(),
    }
}

#[cfg(test)]
mod tests {
    use contract::observatory::{Unsolved, UnsolvedClass};

    use super::*;

    fn facts() -> FrameFacts {
        FrameFacts { stars: Some(418), fwhm_px: Some(1.93), trailed: Some(false), ..FrameFacts::default() }
    }

    fn table(rows: &str) -> HeaderTable {
        format!("header,dtype,fixed,device_type,device_command,comment\n{rows}").parse().unwrap()
    }

    #[test]
    fn what_was_measured_stands_in_the_header_with_its_unit() {
        let plan = plan(&HeaderTable::default(), &facts());
        let records: Vec<String> = plan.cards.iter().map(|card| card.record().unwrap().trim_end().to_owned()).collect();
        assert_eq!(
            records,
            [
                "NSTARS  =                  418 / stars found",
                "FWHM    =                 1.93 / [pix] median FWHM of the best stars, Moffat",
                "TRAILED =                    F / all stars are drawn out in one direction",
            ]
        );
        assert!(plan.history.is_empty());
    }

    /// East on the left when north is up is the sky as it is, whatever way the camera is turned.
    #[test]
    fn a_mirror_image_is_one_by_the_matrix_of_the_solution() {
        for (cd_deg_px, expected) in [
            ([[-1e-4, 0.0], [0.0, 1e-4]], false),
            ([[1e-4, 0.0], [0.0, -1e-4]], false),
            ([[0.0, 1e-4], [1e-4, 0.0]], false),
            ([[1e-4, 0.0], [0.0, 1e-4]], true),
            ([[0.0, -1e-4], [1e-4, 0.0]], true),
        ] {
            let wcs = FrameWcs { ra_deg: 1.0, dec_deg: 2.0, x_px: 3.0, y_px: 4.0, cd_deg_px, sip: None };
            // What the facts say is about the picture with its first row at the top.
            let facts = FrameFacts { wcs: Some(wcs), mirrored: Some(!expected), ..FrameFacts::default() };
            let cards = plan(&HeaderTable::default(), &facts).cards;
            let value = cards.iter().find(|card| card.keyword == "MIRRORED").map(|card| card.value.clone());
            assert_eq!(value, Some(expected.into()), "{cd_deg_px:?}");
        }
    }

    #[test]
    fn every_keyword_fits_its_card() {
        for (keyword, _, comment) in KEYWORDS {
            let record = Card::new(keyword, CardValue::Float(0.123_456), comment).record().unwrap();
            assert!(keyword.len() <= 8 && record.trim_end().ends_with(comment), "{record}");
            assert!(makes(keyword));
        }
    }

    #[test]
    fn the_table_of_the_site_has_the_last_word() {
        let from_elsewhere = table("FWHM,float,true,static,2.5,by hand\n");
        assert!(plan(&from_elsewhere, &facts()).cards.iter().all(|card| card.keyword != "FWHM"));
        let own_words = table("FWHM,float,false,astra,,[pix] how sharp\nNSTARS,int,false,astra,,\n");
        assert!(crate::header::check(&own_words).is_empty());
        let comments: Vec<String> = plan(&own_words, &facts()).cards.into_iter().map(|card| card.comment).collect();
        assert_eq!(comments[..2], ["stars found", "[pix] how sharp"]);
    }

    #[test]
    fn a_frame_that_was_not_measured_gives_the_reason() {
        let facts = FrameFacts { reason: Some("not fetched: HTTP 404".to_owned()), ..FrameFacts::default() };
        assert_eq!(plan(&HeaderTable::default(), &facts).history, ["not measured: not fetched: HTTP 404"]);
        let unsolved = Unsolved { class: UnsolvedClass::Clouds, detail: "clouds: 3 stars".to_owned() };
        let facts = FrameFacts { unsolved: Some(unsolved), ..FrameFacts::default() };
        let plan = plan(&HeaderTable::default(), &facts);
        assert_eq!(plan.history, ["not solved: clouds: 3 stars"]);
        assert_eq!(plan.cards, [Card::new("SOLVED", false.into(), "a plate solution was found")]);
    }

    #[test]
    fn a_frame_that_does_not_count_is_marked_with_the_reason() {
        let why = "flat: 12345 ADU, expected 31500 within 6300 ADU";
        let plan =
            plan(&HeaderTable::default(), &FrameFacts { refused: Some(why.to_owned()), ..FrameFacts::default() });
        assert_eq!(plan.cards, [Card::new("REFUSED", true.into(), "the frame does not count; HISTORY says why")]);
        assert_eq!(plan.history, [format!("does not count: {why}")]);
    }
}
