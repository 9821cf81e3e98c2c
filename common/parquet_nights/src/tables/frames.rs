//! Frames: their files, their facts, and what guiding did about them.

use super::{given, maybe};
use crate::table::{Column, Kind, Table};

const IMAGES_COLUMNS: &[Column] = &[
    given("frame_id", Kind::Text, "the frame; the key of `facts` and `guiding`, and `FRAMEID` in the FITS header"),
    given("filename", Kind::Text, "the FITS file, as the archive node named it on its host"),
    given("camera_name", Kind::Text, "the camera"),
    given("complete_hdr", Kind::Bool, "the header is complete"),
    given("date_obs", Kind::Stamp, "when the exposure began"),
    given("file", Kind::Text, "the FITS file, relative to the folder of images"),
    given("sha256", Kind::Text, "of the pixels, as they came from the camera"),
    given("bytes", Kind::Int, "size of the file"),
    given("stored", Kind::Stamp, "when the file was written"),
    given("frame", Kind::Text, "all that the camera's node announced, as JSON"),
    maybe("object", Kind::Text, "the target").derived_by("json_extract(frame, '$.purpose.object')"),
    maybe("filter", Kind::Text, "the filter").derived_by("json_extract(frame, '$.purpose.filter')"),
    maybe("image_type", Kind::Text, "FITS `IMAGETYP`").derived_by("json_extract(frame, '$.purpose.image_type')"),
    maybe("exposure_s", Kind::Real, "exposure time").derived_by("CAST(json_extract(frame, '$.exposure_s') AS REAL)"),
];

/// Each frame that was stored.
pub(super) const IMAGES: Table = Table {
    name: "images",
    about: "each frame that was stored",
    columns: IMAGES_COLUMNS,
    key: 1,
    group: 0,
    prefer: None,
    from: "images WHERE date_obs >= :from AND date_obs < :to AND telescope IN (:telescope, '')",
    next: Some("SELECT min(date_obs) FROM images WHERE date_obs >= :from AND telescope IN (:telescope, '')"),
    insert: None,
    into: "images",
    owner: Some("telescope"),
    before: None,
};

const FACTS_COLUMNS: &[Column] = &[
    given("frame_id", Kind::Text, "the frame"),
    maybe("camera_name", Kind::Text, "the camera"),
    maybe("filter", Kind::Text, "the filter"),
    maybe("image_type", Kind::Text, "FITS `IMAGETYP`"),
    maybe("date_obs", Kind::Stamp, "when the exposure began"),
    maybe("stars", Kind::Int, "stars that were measured"),
    maybe("fwhm_px", Kind::Real, "full width of the stars at half maximum"),
    maybe("fwhm_error_px", Kind::Real, "its error"),
    maybe("ellipticity", Kind::Real, "of the stars"),
    maybe("elongation_deg", Kind::Real, "in which direction the stars are drawn out"),
    maybe("trailed", Kind::Bool, "the stars are drawn out in one direction"),
    maybe("sky_adu", Kind::Real, "level of the sky"),
    maybe("noise_adu", Kind::Real, "noise of the sky"),
    maybe("saturated_fraction", Kind::Real, "of the pixels"),
    maybe("defect_fraction", Kind::Real, "of the pixels"),
    maybe("zero_point_mag", Kind::Real, "photometric zero point"),
    maybe("transparency", Kind::Real, "light of the stars, compared with the best of the row"),
    maybe("reason", Kind::Text, "why nothing was measured"),
    given("facts", Kind::Text, "all facts, as JSON"),
    given("datetime", Kind::Stamp, "when they were published"),
    given("boot_id", Kind::Text, "incarnation of the node that published them"),
    given("seq", Kind::Int, "number of the sample"),
    given("in_header", Kind::Int, "0 not yet in the FITS header, 1 in it, 2 the file is gone"),
    maybe("ra_deg", Kind::Real, "right ascension of the image's centre, ICRS"),
    maybe("dec_deg", Kind::Real, "declination of the image's centre, ICRS"),
    maybe("scale_arcsec_px", Kind::Real, "scale"),
    maybe("rotation_deg", Kind::Real, "position angle of the image"),
    maybe("mirrored", Kind::Bool, "the image is mirrored"),
    maybe("matched", Kind::Int, "stars of the solution"),
    maybe("rms_px", Kind::Real, "of the solution"),
    maybe("false_alarm", Kind::Real, "probability that the solution is an accident"),
    maybe("off_target_arcmin", Kind::Real, "distance from the target"),
    maybe("airmass", Kind::Real, "of the exposure"),
    maybe("zero_point_error_mag", Kind::Real, "its error"),
    maybe("unsolved", Kind::Text, "why there is no solution"),
];

/// Each frame that was measured.
pub(super) const FACTS: Table = Table {
    name: "facts",
    about: "each frame that was measured",
    columns: FACTS_COLUMNS,
    key: 1,
    group: 0,
    prefer: Some("datetime"),
    from: "facts WHERE ((date_obs >= :from AND date_obs < :to) OR
        (date_obs IS NULL AND datetime >= :from AND datetime < :to)) AND telescope IN (:telescope, '')",
    next: Some(
        "SELECT min(at) FROM (SELECT min(date_obs) AS at FROM facts WHERE date_obs >= :from AND telescope IN (:telescope, '')
            UNION ALL SELECT min(datetime) FROM facts
                WHERE date_obs IS NULL AND datetime >= :from AND telescope IN (:telescope, ''))",
    ),
    insert: None,
    into: "facts",
    owner: Some("telescope"),
    before: None,
};

const GUIDING_COLUMNS: &[Column] = &[
    given("frame_id", Kind::Text, "the frame that was compared"),
    given("datetime", Kind::Stamp, "middle of its exposure"),
    given("camera_name", Kind::Text, "the guide camera"),
    maybe("object", Kind::Text, "the target"),
    maybe("filter", Kind::Text, "the filter"),
    maybe("pier_side", Kind::Text, "of the mount"),
    given("reference", Kind::Text, "the frame that it was compared with"),
    given("stage", Kind::Text, "stage of guiding"),
    maybe("shift_x", Kind::Real, "shift of the field, pixels"),
    maybe("shift_y", Kind::Real, "shift of the field, pixels"),
    maybe("error_px", Kind::Real, "error of the shift"),
    maybe("rotation_deg", Kind::Real, "of the field"),
    given("stars", Kind::Int, "stars that were compared"),
    maybe("fwhm_px", Kind::Real, "of the stars"),
    maybe("transparency", Kind::Real, "compared with the reference"),
    maybe("method", Kind::Text, "how the shift was found"),
    maybe("reason", Kind::Text, "why there is none"),
    maybe("further_action", Kind::Text, "what was done in addition"),
    maybe("rms_px", Kind::Real, "of the last corrections"),
    given("east_why", Kind::Text, "what was decided for the axis east"),
    maybe("east_error_px", Kind::Real, "how far the field was off to the east"),
    given("east_expected_px", Kind::Real, "how far it was expected to be off"),
    given("east_drift_px_per_s", Kind::Real, "drift"),
    given("east_pulse_ms", Kind::Int, "pulse that was requested; negative to the other side"),
    given("east_given_ms", Kind::Int, "pulse that was given"),
    given("north_why", Kind::Text, "what was decided for the axis north"),
    maybe("north_error_px", Kind::Real, "how far the field was off to the north"),
    given("north_expected_px", Kind::Real, "how far it was expected to be off"),
    given("north_drift_px_per_s", Kind::Real, "drift"),
    given("north_pulse_ms", Kind::Int, "pulse that was requested; negative to the other side"),
    given("north_given_ms", Kind::Int, "pulse that was given"),
    given("correction", Kind::Text, "the whole correction, as JSON"),
    given("boot_id", Kind::Text, "incarnation of the node that published it"),
    given("seq", Kind::Int, "number of the sample"),
];

/// Each correction of guiding.
pub(super) const GUIDING: Table = Table {
    name: "guiding",
    about: "each correction of guiding",
    columns: GUIDING_COLUMNS,
    key: 1,
    group: 0,
    prefer: None,
    from: "guiding WHERE telescope = :telescope AND datetime >= :from AND datetime < :to",
    next: Some("SELECT min(datetime) FROM guiding WHERE datetime >= :from AND telescope = :telescope"),
    insert: None,
    into: "guiding",
    owner: Some("telescope"),
    before: None,
};
