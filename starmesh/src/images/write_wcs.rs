//! Writes a solution: as CD and SIP on the screen, into the frame's own header, or into a header of its own.

use std::path::Path;

use anyhow::{Context as _, ensure};
use imaging::Wcs;
use imaging::wcs::{Sip, Term};
use node_archive::card::{Card, CardValue};
use node_archive::solution::card;
use node_archive::stored_header::Header;
use serde_json::{Map, Value, json};

/// Puts a solution into the header of an HDU of a frame.
pub fn into_frame(file: &Path, hdu: usize, wcs: &Wcs, size_px: (usize, usize)) -> anyhow::Result<()> {
    let mut problem = None;
    let change = |old: &[u8]| {
        let Some(mut header) = Header::read_from(old).ok().flatten() else {
            problem = Some("its header has no end");
            return (Vec::new(), 0);
        };
        header.retain(|keyword| !is_wcs(keyword));
        cards(wcs, size_px).iter().for_each(|card| header.set(card));
        header.update_checksum();
        (header.to_bytes(), header.length())
    };
    fits::rewrite::header(file, hdu, change).context("the solution is not written")?;
    ensure!(problem.is_none(), "{}: {}", file.display(), problem.unwrap_or_default());
    Ok(())
}

/// Writes a solution as a FITS header without data.
pub fn into_file(file: &Path, wcs: &Wcs, size_px: (usize, usize)) -> anyhow::Result<()> {
    let unwritten = || format!("{} cannot be written; the solution is not there", file.display());
    let begin: String =
        ["SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"]
            .iter()
            .chain([&"END"])
            .map(|card| format!("{card:80}"))
            .collect();
    let header = Header::read_from(format!("{begin:2880}").as_bytes()).with_context(unwritten)?;
    let mut header = header.with_context(unwritten)?;
    cards(wcs, size_px).iter().for_each(|card| header.set(card));
    let number = |keyword: &str, px: usize, comment: &str| Card::new(keyword, CardValue::Int(px as i64), comment);
    header.set(&number("IMAGEW", size_px.0, "[px] columns of the frame"));
    header.set(&number("IMAGEH", size_px.1, "[px] rows of the frame"));
    fits::rewrite::write_at_once(file, &header.to_bytes(), None).with_context(unwritten)
}

fn cards(wcs: &Wcs, size_px: (usize, usize)) -> Vec<Card> {
    wcs.cards(size_px.0, size_px.1).iter().map(card).collect()
}

/// Whether a keyword is part of a frame's first world coordinate system, of any convention: another system next to ours
/// would be read together with it.
fn is_wcs(keyword: &str) -> bool {
    const PLAIN: [&str; 5] = ["WCSAXES", "RADESYS", "RADECSYS", "LONPOLE", "LATPOLE"];
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|c| c.is_ascii_digit());
    let of_axis = ["CTYPE", "CUNIT", "CRVAL", "CRPIX", "CDELT", "CROTA"];
    let axis = of_axis.iter().any(|start| keyword.strip_prefix(start).is_some_and(is_number));
    // CD1_2, PC1_2, PV1_10, PS2_0; PC001002 of an older draft; WAT1_001 of IRAF.
    let matrix = ["CD", "PC", "PV", "PS", "WAT"].iter().any(|start| {
        let rest = keyword.strip_prefix(start);
        rest.is_some_and(|rest| rest.split_once('_').is_some_and(|(a, b)| is_number(a) && is_number(b)))
    });
    let old = keyword.len() == 8 && keyword.strip_prefix("PC").is_some_and(is_number);
    let sip = ["A_", "B_", "AP_", "BP_"].iter().any(|start| {
        let rest = keyword.strip_prefix(start);
        rest.is_some_and(|rest| {
            matches!(rest, "ORDER" | "DMAX") || rest.split_once('_').is_some_and(|(p, q)| is_number(p) && is_number(q))
        })
    });
    PLAIN.contains(&keyword) || axis || matrix || old || sip
}

/// The terms of a distortion that are not zero, by name: A, B.
fn terms(sip: &Sip) -> [Vec<(String, f64)>; 2] {
    let name = |term: Term| (format!("{}_{}", term.p, term.q), term.coefficient);
    sip.terms().map(|terms| terms.into_iter().map(name).filter(|(_, coefficient)| *coefficient != 0.0).collect())
}

/// A solution as JSON, in the terms of FITS (pixels from 1).
pub fn object(wcs: &Wcs) -> Value {
    let polynomial = |terms: &[(String, f64)]| -> Value {
        Value::Object(terms.iter().map(|(name, value)| (name.clone(), json!(value))).collect::<Map<String, Value>>())
    };
    let sip = wcs.sip.map(|sip| {
        let [a, b] = terms(&sip);
        json!({ "a": polynomial(&a), "b": polynomial(&b) })
    });
    json!({
        "crval_deg": [wcs.ra.degrees(), wcs.dec.degrees()],
        "crpix_px": [wcs.x_px + 1.0, wcs.y_px + 1.0],
        "cd_deg_px": wcs.cd_deg_px,
        "sip": sip,
    })
}

/// A solution in words.
pub fn sentence(wcs: &Wcs) -> String {
    let [[a, b], [c, d]] = wcs.cd_deg_px;
    let mut text = format!("  CD {a:.9e} {b:.9e} {c:.9e} {d:.9e} deg/px");
    if let Some(sip) = wcs.sip {
        for (axis, terms) in ["A", "B"].iter().zip(terms(&sip)) {
            let words: Vec<String> = terms.iter().map(|(name, value)| format!("{axis}_{name} {value:.6e}")).collect();
            text += &format!("\n  SIP {}", if words.is_empty() { format!("{axis} 0") } else { words.join(", ") });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keywords_of_every_convention_are_known_and_no_others() {
        for keyword in [
            "WCSAXES", "CTYPE1", "CD1_2", "PC2_1", "PC001002", "CDELT2", "CROTA2", "PV1_10", "PS2_0", "A_ORDER",
            "BP_5_0", "B_DMAX", "RADECSYS", "WAT1_001", "LONPOLE",
        ] {
            assert!(is_wcs(keyword), "{keyword}");
        }
        for keyword in
            ["EQUINOX", "RA", "CTYPE1A", "CD_TEMP", "PCOUNT", "A_CAM", "APERTURE", "PVER", "CRVAL", "PS_1", "DATE-OBS"]
        {
            assert!(!is_wcs(keyword), "{keyword}");
        }
    }
}
