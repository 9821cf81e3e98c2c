//! Checks the devices that a row needs: filters of the camera's wheel, a mount, a focuser.

use std::collections::BTreeSet;

use config::meant;
use contract::Name;
use contract::observatory::{Check, Finding};

use super::KnownFacts;
use crate::fault::{Right as _, error};
use crate::row::{PartOfRow, Row};
use crate::written::{Of, Written};
use crate::wrong::Mend;

/// Filters that no wheel of the camera has; mounts that are not there.
pub(super) fn check(rows: &[Row], parts: &[PartOfRow], known: &KnownFacts) -> Vec<Finding> {
    let of_row = |row: &Row| {
        let filters = filters(&row.camera, row.action.filters(), &row.written, known);
        filters.into_iter().chain(mount(row, known))
    };
    let of_part = |part: &PartOfRow| {
        let wanted = part.filters.iter().map(String::as_str).collect();
        part.camera.as_ref().map(|camera| filters(camera, wanted, &part.written, known)).unwrap_or_default()
    };
    rows.iter().flat_map(of_row).chain(parts.iter().flat_map(of_part)).collect()
}

fn filters(camera: &Name, wanted: Vec<&str>, written: &Written, known: &KnownFacts) -> Vec<Finding> {
    let (false, Some(camera)) = (wanted.is_empty(), known.camera(camera)) else { return Vec::new() };
    let at = written.parameter("filter");
    let Some(wheel) = &camera.filterwheel else {
        let what = format!("{} has no filter wheel, and {:?} is asked for", camera.common.name, wanted.join(", "));
        return vec![
            error(Check::Filter, at, Some("filter"), what).right("leave the filter out, or pair a wheel with it"),
        ];
    };
    let Some(filters) = known.filters.get(wheel) else { return Vec::new() };
    let each: BTreeSet<&str> = wanted.into_iter().filter(|wanted| !filters.iter().any(|has| has == wanted)).collect();
    let describe = |wanted: &str| {
        let found = error(Check::Filter, at, Some("filter"), format!("{wheel} has no filter {wanted:?}"));
        let known = filters.iter().map(String::as_str);
        let fix = written.mend(Of::Parameters, "filter", Mend::word(wanted, known.clone()));
        found.right(meant(wanted, known)).fix(fix)
    };
    each.into_iter().map(describe).collect()
}

fn mount(row: &Row, known: &KnownFacts) -> Option<Finding> {
    let needs = row.action.needs();
    // `open` opens the roof, too, and `autofocus` works without a mount, where the telescope points.
    let points = needs.mount && needs.safe && !["open", "autofocus"].contains(&row.action.name());
    let camera = known.camera(&row.camera).filter(|camera| points && camera.telescope.is_none())?;
    let what = format!("{} has no mount that {} could point", camera.common.name, row.action.name());
    let found = error(Check::Device, row.written.field("device_name"), Some("device_name"), what);
    Some(found.right("name the camera's telescope in the configuration"))
}

/// Wheels whose filters are asked for and not known.
pub(super) fn unchecked(rows: &[Row], parts: &[PartOfRow], known: &KnownFacts) -> Vec<String> {
    let of_rows = rows.iter().filter(|row| !row.action.filters().is_empty()).map(|row| &row.camera);
    let of_parts = parts.iter().filter(|part| !part.filters.is_empty()).filter_map(|part| part.camera.as_ref());
    let wheels = of_rows.chain(of_parts).filter_map(|camera| known.camera(camera)?.filterwheel.as_ref());
    let wheels: BTreeSet<&Name> = wheels.filter(|wheel| !known.filters.contains_key(*wheel)).collect();
    let describe = |wheel: &Name| {
        format!("filters of {wheel}: the wheel has reported none to this check, and filterwheel.filters is not set")
    };
    wheels.into_iter().map(describe).collect()
}
