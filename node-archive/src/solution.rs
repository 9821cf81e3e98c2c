//! The cards of a plate solution: the standard world coordinate system of FITS, so that any program knows what the
//! pixels show.
//!
//! TAN with SIP polynomials, which have no terms where no distortion was seen, so that all frames of a series have one form; Calabretta & Greisen 2002, A&A 395, 1077 and Shupe et al.
//! 2005, ASP Conf. 347, 491. A WCS is whole or nothing: where the site's table takes one of its keywords from
//! elsewhere, none is written, and the history contains a line about it.

use config::header::{HeaderTable, Source};
use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, FrameWcs};
use imaging::Wcs;
use imaging::wcs::{Sip, Value};
use units::Angle;

use crate::card::{Card, CardValue};
use crate::plan::Plan;

/// Keywords of the frame of coordinates, which a table may list as well: RA and DEC have the same one.
const FRAME: [&str; 2] = ["RADESYS", "EQUINOX"];

/// The begin of the line of history about a solution that is not written.
const LEFT_OUT: &str = "plate solution left out";

/// The keywords that the solution of a frame adds to its header; none where there is no solution.
pub fn plan(table: &HeaderTable, facts: &FrameFacts, frame: &Frame) -> Plan {
    let row = |keyword: &str| table.rows.iter().find(|row| row.keyword == keyword);
    // RADESYS is in every header.
    let is_own = |keyword: &&str| match row(keyword) {
        None => *keyword != "RADESYS",
        Some(row) => row.source == Source::Computed && !FRAME.contains(keyword),
    };
    let mut plan = Plan {
        own_history: vec![LEFT_OUT],
        own_keywords: PLAIN.into_iter().filter(is_own).collect(),
        ..Plan::default()
    };
    let Some(solution) = &facts.wcs else { return plan };
    let (width, height) = (frame.width_px as usize, frame.height_px as usize);
    let mut cards: Vec<Card> = wcs(solution).cards(width, height).iter().map(card).collect();
    if solution.sip.is_none() {
        cards.iter_mut().for_each(as_distorted);
        cards.extend(["A", "B", "AP", "BP"].map(|polynomial| {
            Card::new(&format!("{polynomial}_ORDER"), CardValue::Int(2), "order of the distortion polynomial, no terms")
        }));
    }
    cards.push(Card::new("EQUINOX", CardValue::Float(2000.0), "equinox of CRVAL1 and CRVAL2"));
    cards.retain(|card| !(FRAME.contains(&card.keyword.as_str()) && row(&card.keyword).is_some()));
    let taken = cards.iter().find(|card| row(&card.keyword).is_some_and(|row| row.source != Source::Computed));
    if let Some(taken) = taken {
        plan.history.push(format!("{LEFT_OUT}: the header table takes {} from elsewhere", taken.keyword));
        return plan;
    }
    Plan { cards, ..plan }
}

/// Frames of a series have one form: one on which no distortion was seen has a polynomial without terms.
fn as_distorted(card: &mut Card) {
    if let (true, CardValue::Text(kind)) = (card.keyword.starts_with("CTYPE"), &mut card.value) {
        kind.push_str("-SIP");
    }
}

/// The keywords of a solution without the terms of its distortion.
pub const PLAIN: [&str; 15] = [
    "WCSAXES", "CTYPE1", "CTYPE2", "CUNIT1", "CUNIT2", "RADESYS", "EQUINOX", "CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2",
    "CD1_1", "CD1_2", "CD2_1", "CD2_2",
];

/// Whether a solution makes this keyword.
pub fn makes(keyword: &str) -> bool {
    let distortion = ["A_", "B_", "AP_", "BP_"].iter().any(|begins| keyword.starts_with(begins));
    PLAIN.contains(&keyword) || distortion
}

/// Whether a keyword is part of a SIP distortion: `A_ORDER`, `BP_1_2`, `A_DMAX` (Shupe et al. 2005).
fn is_distortion(keyword: &str) -> bool {
    let Some((polynomial, term)) = keyword.split_once('_') else { return false };
    let is_power = |text: &str| text.len() == 1 && text.bytes().all(|c| c.is_ascii_digit());
    let is_term = term.split_once('_').is_some_and(|(x, y)| is_power(x) && is_power(y));
    matches!(polynomial, "A" | "B" | "AP" | "BP") && (is_term || matches!(term, "ORDER" | "DMAX"))
}

/// Whether a keyword of a stored header stays when a plan is put in: a frame that was solved anew, without
/// distortion or with another, or is not solved any more, keeps no term of the solution before.
pub fn stays(keyword: &str, plan: &Plan) -> bool {
    let is_own = |keyword: &str| plan.own_keywords.contains(&keyword);
    let is_renewed = is_own(keyword) || (is_own("CTYPE1") && is_distortion(keyword));
    !is_renewed || plan.cards.iter().any(|card| card.keyword == keyword)
}

/// The solution as the imaging crate computes with it.
pub fn wcs(solution: &FrameWcs) -> Wcs {
    Wcs {
        ra: Angle::from_degrees(solution.ra_deg),
        dec: Angle::from_degrees(solution.dec_deg),
        x_px: solution.x_px,
        y_px: solution.y_px,
        cd_deg_px: solution.cd_deg_px,
        sip: solution.sip.map(|sip| Sip { a: sip.a, b: sip.b }),
    }
}

/// A card of a solution as it is written.
pub fn card(card: &imaging::wcs::Card) -> Card {
    let value = match &card.value {
        Value::Text(text) => CardValue::Text(text.clone()),
        Value::Integer(number) => CardValue::Int(*number),
        Value::Number(number) => CardValue::Float(*number),
    };
    Card::new(&card.name, value, card.comment)
}

#[cfg(test)]
mod tests {
    use contract::observatory::Distortion;

    use super::*;

    fn frame() -> Frame {
        let text = include_str!("../../common/contract/golden/v1/camera.frame.json");
        let samples: serde_json::Value = serde_json::from_str(text).unwrap();
        let sample = samples.get(0).unwrap_or(&samples);
        serde_json::from_value(sample.clone()).unwrap()
    }

    fn facts(sip: Option<Distortion>) -> FrameFacts {
        let cd_deg_px = [[-9.7e-5, 1e-6], [1e-6, 9.7e-5]];
        let wcs = FrameWcs { ra_deg: 346.5, dec_deg: -5.25, x_px: 511.5, y_px: 255.5, cd_deg_px, sip };
        FrameFacts { wcs: Some(wcs), ..FrameFacts::default() }
    }

    fn table(rows: &str) -> HeaderTable {
        format!("header,dtype,fixed,device_type,device_command,comment\n{rows}").parse().unwrap()
    }

    #[test]
    fn pixels_are_counted_from_one_and_the_frame_of_coordinates_is_reported() {
        let plan = plan(&table(""), &facts(None), &frame());
        let records: Vec<String> = plan.cards.iter().map(|card| card.record().unwrap()).collect();
        for begin in [
            "WCSAXES =                    2 /",
            "CTYPE1  = 'RA---TAN-SIP'",
            "CTYPE2  = 'DEC--TAN-SIP'",
            "A_ORDER =                    2 /",
            "BP_ORDER=                    2 /",
            "RADESYS = 'ICRS    '",
            "EQUINOX =               2000.0 /",
            "CRVAL1  =                346.5 /",
            "CRPIX1  =                512.5 /",
            "CRPIX2  =                256.5 /",
            "CD1_1   =              -9.7E-5 /",
            "CD2_1   =               1.0E-6 /",
        ] {
            assert!(records.iter().any(|record| record.starts_with(begin)), "{begin} in {records:#?}");
        }
        assert!(records[0].starts_with("WCSAXES"), "the standard wants it before all others");
        assert!(plan.cards.iter().all(|card| makes(&card.keyword)));
    }

    /// A field with few stars shows no distortion, and the frame behind it does: a program that reads a series meets one form.
    #[test]
    fn frames_of_a_series_have_one_form_of_coordinates() {
        let sip = Distortion { a: [0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9, 0.0], b: [0.0, 0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9] };
        let form = |sip| {
            let cards = plan(&HeaderTable::default(), &facts(sip), &frame()).cards;
            let is_form = |card: &Card| card.keyword.starts_with("CTYPE") || card.keyword.ends_with("_ORDER");
            let of_form = cards.into_iter().filter(is_form);
            of_form
                .map(|card| (card.keyword, matches!(card.value, CardValue::Text(_)).then_some(card.value)))
                .collect::<Vec<_>>()
        };
        let (bent, plain) = (form(Some(sip)), form(None));
        let sorted = |mut cards: Vec<(String, Option<CardValue>)>| {
            cards.sort_by(|a, b| a.0.cmp(&b.0));
            cards
        };
        assert_eq!(sorted(bent), sorted(plain));
    }

    #[test]
    fn distortion_stands_there_with_its_inverse() {
        let sip = Distortion { a: [0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9, 0.0], b: [0.0, 0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9] };
        let plan = plan(&HeaderTable::default(), &facts(Some(sip)), &frame());
        let value =
            |keyword: &str| plan.cards.iter().find(|card| card.keyword == keyword).map(|card| card.value.clone());
        assert_eq!(value("CTYPE1"), Some("RA---TAN-SIP".into()));
        assert_eq!((value("A_ORDER"), value("A_3_0")), (Some(CardValue::Int(3)), Some(CardValue::Float(2e-9))));
        assert!(value("AP_3_0").is_some() && value("BP_ORDER").is_some());
        assert!(plan.cards.iter().all(|card| makes(&card.keyword) && card.record().is_some()));
        assert!(plan.cards.len() <= crate::header::room(&HeaderTable::default()), "{} cards", plan.cards.len());
    }

    #[test]
    fn a_new_solution_leaves_no_term_of_the_one_before() {
        let sip = Distortion { a: [0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9, 0.0], b: [0.0, 0.0, 0.0, 0.0, 2e-9, 0.0, 2e-9] };
        let bent = plan(&HeaderTable::default(), &facts(Some(sip)), &frame());
        let plain = plan(&HeaderTable::default(), &facts(None), &frame());
        let unsolved = plan(&HeaderTable::default(), &FrameFacts::default(), &frame());
        assert!(bent.cards.iter().any(|card| is_distortion(&card.keyword)));
        for card in &bent.cards {
            assert!(stays(&card.keyword, &bent), "{}: the same again", card.keyword);
            let is_term = is_distortion(&card.keyword) && !card.keyword.ends_with("_ORDER");
            assert_eq!(stays(&card.keyword, &plain), !is_term, "{}", card.keyword);
            assert!(stays(&card.keyword, &Plan::default()), "{}: nothing is known of a solution", card.keyword);
            assert!(!stays(&card.keyword, &unsolved), "{}: it is solved no more", card.keyword);
        }
        assert!(
            ["RADESYS", "EQUINOX"].iter().all(|keyword| stays(keyword, &unsolved)),
            "they are about RA and DEC too"
        );
        for other in ["A_GAIN", "B_12_3", "APERTURE", "AP_", "BP", "FILTER"] {
            assert!(stays(other, &plain), "{other} is no distortion");
        }
    }

    #[test]
    fn a_table_with_a_word_of_its_own_gets_no_half_of_a_solution() {
        let lists_the_frame = table("RADESYS,str,true,static,ICRS,\nEQUINOX,float,true,static,2000,\n");
        let cards = plan(&lists_the_frame, &facts(None), &frame()).cards;
        assert!(cards.len() == 17 && cards.iter().all(|card| !FRAME.contains(&card.keyword.as_str())));
        let takes_one = table("CRVAL1,float,true,static,10.0,\n");
        let plan = plan(&takes_one, &facts(None), &frame());
        assert!(plan.cards.is_empty() && plan.history[0].contains("takes CRVAL1 from elsewhere"));
    }

    #[test]
    fn an_unsolved_frame_has_no_such_cards() {
        assert!(plan(&HeaderTable::default(), &FrameFacts::default(), &frame()).cards.is_empty());
    }
}
