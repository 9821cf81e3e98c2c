//! Where a focus run looks: a star near the zenith from the catalogue, the zenith itself where there is none.

use imaging::focus::field::{FocusField, Wanted, choose, field_of_view, zenith_limit};
use schedule::action::autofocus::field::FocusField as FieldParameters;
use sky::{Horizontal, Icrs};
use units::{Angle, Utc};

use crate::action_error::ActionError;
use crate::row_context::RowContext;

/// Julian date of J2000.0, and days of a Julian year.
const J2000: (f64, f64) = (2_451_545.0, 365.25);
/// The camera's field where neither frames nor configuration give it, degrees.
pub const USUAL_FIELD_DEG: f64 = 0.5;

/// A field, and how it was chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// Where to point.
    pub place: Icrs,
    /// Why there.
    pub words: String,
}

/// Chooses the field of a run, as its row asks.
pub async fn for_run(asked: &FieldParameters, context: &RowContext) -> Result<Chosen, ActionError> {
    if let Some(place) = asked.place() {
        let place = place.checked()?;
        return Ok(Chosen { place, words: "as the row says".to_owned() });
    }
    let own_field = of_camera(context).await?;
    let along = |given_deg: f64, own: Angle| if given_deg > 0.0 { Angle::from_degrees(given_deg) } else { own };
    let wanted = asked.use_gaia.then(|| Wanted {
        zenith_limit: asked.maximal_zenith_angle.map_or(zenith_limit(asked.airmass_threshold), Angle::from_degrees),
        magnitudes: asked.g_mag_range[0]..=asked.g_mag_range[1],
        field: (along(asked.fov_width, own_field.0), along(asked.fov_height, own_field.1)),
        selection: asked.selection().unwrap_or_default(),
        most_stars: asked.maximal_number_of_stars,
    });
    near_zenith(context, asked.observation_time.unwrap_or(context.clock().utc()), wanted).await
}

/// Chooses a field near the zenith of an instant. Falls back to the zenith where the catalogue has no answer.
pub async fn near_zenith(context: &RowContext, at: Utc, wanted: Option<Wanted>) -> Result<Chosen, ActionError> {
    let up = Horizontal { altitude: Angle::from_degrees(90.0), azimuth: Angle::default() };
    let zenith = context.observer(at)?.to_icrs(&up);
    let at_zenith = |why: &str| Chosen { place: zenith, words: format!("the zenith: {why}") };
    let Some(wanted) = wanted else { return Ok(at_zenith("the row asks for no catalogue")) };
    let Some(catalogue) = context.tools.frames.catalogue.get() else {
        return Ok(at_zenith("no star catalogue is open"));
    };
    let (limit, faintest) = (wanted.zenith_limit, *wanted.magnitudes.end());
    let looked = tokio::task::spawn_blocking(move || {
        let epoch_year = 2000.0 + (at.jd() - J2000.0) / J2000.1;
        let stars = catalogue.cone(zenith.ra, zenith.dec, limit, faintest, epoch_year);
        stars.map(|stars| choose(&stars, (zenith.ra, zenith.dec), &wanted)).map_err(|error| error.to_string())
    });
    Ok(match looked.await.map_err(|error| error.to_string()).and_then(|chosen| chosen) {
        Ok(FocusField { ra, dec, from_zenith, star: Some(star), stars }) => Chosen {
            place: Icrs { ra, dec },
            words: format!(
                "a star of magnitude {:.1}, {:.1} deg from the zenith; {stars} in the field",
                star.mag,
                from_zenith.degrees()
            ),
        },
        Ok(_) => at_zenith("no star fits"),
        Err(why) => {
            tracing::warn!(why, "no field from the catalogue");
            at_zenith("the catalogue cannot be read")
        }
    })
}

/// The camera's field along both axes: as solved frames taught, else by the mount's focal length, else the usual one.
pub async fn of_camera(context: &RowContext) -> Result<(Angle, Angle), ActionError> {
    let camera = context.chain()?.camera;
    let can = camera.instrument.capabilities().await?;
    let optics = context.tools.frames.optics.get();
    let name = context.row.camera.as_str();
    let scale_arcsec_px = optics.optics.iter().rev().find(|optics| optics.camera == name);
    let scale_arcsec_px = scale_arcsec_px.map(|optics| optics.scale_arcsec_px / f64::from(optics.bin.max(1)));
    let scale_arcsec_px = scale_arcsec_px.or(camera.config.scale_arcsec_px);
    // A field of n pixels, each of this scale: the focal length of one millimetre pixels that gives it.
    let along = |pixels: u32| match scale_arcsec_px {
        Some(scale) if pixels > 0 => {
            let focal_length_mm = 1.0 / Angle::from_arcseconds(scale).radians().tan();
            field_of_view(pixels as usize, 1000.0, focal_length_mm)
        }
        Some(_) | None => Angle::from_degrees(USUAL_FIELD_DEG),
    };
    Ok((along(can.width_px), along(can.height_px)))
}
