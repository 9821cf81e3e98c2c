//! Where is the focus? From star sizes to a position, and the run of frames that finds it.
//!
//! - [`sweep`] plans a run frame by frame: where to go, when to expose, what came of it.
//! - [`hyperbola`] is the curve of star sizes ([`crate::hfd`]) against position, with the error of its minimum.
//! - [`operator`] are other measures of sharpness by name, [`smooth`] and [`classic`] the curves to go with them.
//! - [`field`] chooses where to point for a run; [`correction`] says where focus is at another temperature or filter.
//! - [`plot`] draws a run.
//!
//! Positions are the focuser's steps. Nothing here knows a device. Formulae and sources: docs/formulae.md, "Focus".

pub mod classic;
mod contrast;
pub mod correction;
pub mod field;
pub mod hyperbola;
pub mod image;
mod least_squares;
pub mod operator;
pub mod plot;
pub mod smooth;
mod spectrum;
mod star_size;
pub mod sweep;

pub use hyperbola::{Hyperbola, NoHyperbola, Size};
pub use image::Image;
pub use operator::{Better, OPERATORS, Operator, UnknownOperator};
pub use smooth::{NoExtremum, SMOOTHERS, Smoother};
pub use sweep::{FocusStep, Plan, Sweep};

/// The entry of that name, or the only one whose name begins so, whatever its case; else all names there are.
fn by_name<'a, T>(table: &'a [T], name_of: fn(&T) -> &'static str, name: &str) -> Result<&'a T, String> {
    let wanted = name.trim().to_lowercase().replace([' ', '-'], "_");
    let begins: Vec<&T> =
        table.iter().filter(|entry| !wanted.is_empty() && name_of(entry).starts_with(&wanted)).collect();
    let exact = begins.iter().find(|entry| name_of(entry) == wanted);
    match (exact, begins.as_slice()) {
        (Some(entry), _) | (None, [entry]) => Ok(*entry),
        _ => Err(table.iter().map(name_of).collect::<Vec<_>>().join(", ")),
    }
}

/// The median; of an even number the mean of the two in the middle. None of nothing.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = values.get(values.len() / 2)?;
    let lower = if values.len().is_multiple_of(2) { values.get(values.len() / 2 - 1)? } else { upper };
    Some(0.5 * (lower + upper))
}
