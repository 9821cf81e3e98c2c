//! What the observatory node did and why, and the fluxes of stars.

use super::{given, maybe};
use crate::table::{Column, Kind, Table};

/// What these tables have in common: rows by their own keys, restored as they were.
const PLAIN: Table = Table {
    name: "",
    about: "",
    columns: &[],
    key: 0,
    group: 0,
    prefer: None,
    from: "",
    next: None,
    insert: None,
    into: "",
    owner: None,
    before: None,
};

const STATES_COLUMNS: &[Column] = &[
    given("part", Kind::Text, "part of the observatory node, such as `night` or `safety`"),
    given("boot_id", Kind::Text, "incarnation of the node that published it"),
    given("seq", Kind::Int, "number of the sample"),
    given("datetime", Kind::Stamp, "from when on it was so"),
    given("last", Kind::Stamp, "when it was received for the last time"),
    given("same", Kind::Text, "what makes it another state than the one before"),
    given("state", Kind::Text, "the state, as JSON"),
];

/// Each state of a part of the observatory node.
pub(super) const STATES: Table = Table {
    name: "states",
    about: "each state of a part of the observatory node, from its first to its last sample",
    columns: STATES_COLUMNS,
    key: 3,
    from: "states WHERE datetime >= :from AND datetime < :to AND telescope IN (:telescope, '')",
    next: Some("SELECT min(datetime) FROM states WHERE datetime >= :from AND telescope IN (:telescope, '')"),
    into: "states",
    owner: Some("telescope"),
    prefer: Some("last"),
    ..PLAIN
};

const SCHEDULE_ROWS_COLUMNS: &[Column] = &[
    given("number", Kind::Int, "place of the row in the schedule"),
    given("boot_id", Kind::Text, "incarnation of the node that published it"),
    given("seq", Kind::Int, "number of the sample"),
    given("datetime", Kind::Stamp, "from when on it was so"),
    given("action", Kind::Text, "the action"),
    given("camera_name", Kind::Text, "the camera"),
    maybe("object", Kind::Text, "the target"),
    given("starts", Kind::Stamp, "when its window begins"),
    given("ends", Kind::Stamp, "when its window ends"),
    given("status", Kind::Text, "how far it is"),
    given("frames", Kind::Int, "frames that count"),
    maybe("frames_wanted", Kind::Int, "frames that it asks for"),
    given("detail", Kind::Text, "the same in words"),
    given("row", Kind::Text, "the whole row, as JSON"),
];

/// Each change of a row of the schedule.
pub(super) const SCHEDULE_ROWS: Table = Table {
    name: "schedule_rows",
    about: "each change of a row of the schedule",
    columns: SCHEDULE_ROWS_COLUMNS,
    key: 3,
    from: "schedule_rows WHERE datetime >= :from AND datetime < :to AND telescope IN (:telescope, '')",
    next: Some("SELECT min(datetime) FROM schedule_rows WHERE datetime >= :from AND telescope IN (:telescope, '')"),
    into: "schedule_rows",
    owner: Some("telescope"),
    ..PLAIN
};

const ALERTS_COLUMNS: &[Column] = &[
    given("id", Kind::Text, "kind of alert and what it is about"),
    given("raised", Kind::Stamp, "when it was raised"),
    given("priority", Kind::Text, "its priority"),
    given("cause", Kind::Text, "the last cause"),
    maybe("acknowledged_by", Kind::Text, "the person who acknowledged it"),
    maybe("cleared", Kind::Stamp, "when it was cleared; no value while it is active"),
    given("last", Kind::Stamp, "when it was received for the last time"),
    given("boot_id", Kind::Text, "incarnation of the node that published it"),
    given("seq", Kind::Int, "number of the sample"),
];

/// Each alert.
pub(super) const ALERTS: Table = Table {
    name: "alerts",
    about: "each alert, from when it was raised",
    columns: ALERTS_COLUMNS,
    key: 2,
    from: "alerts WHERE raised >= :from AND raised < :to AND telescope IN (:telescope, '')",
    next: Some("SELECT min(raised) FROM alerts WHERE raised >= :from AND telescope IN (:telescope, '')"),
    into: "alerts",
    owner: Some("telescope"),
    prefer: Some("last"),
    ..PLAIN
};

const SERIES_STARS_COLUMNS: &[Column] = &[
    given("series", Kind::Text, "frames whose fluxes can be compared"),
    given("star", Kind::Int, "the star; 0 is the target"),
    given("ra_deg", Kind::Real, "right ascension, ICRS"),
    given("dec_deg", Kind::Real, "declination, ICRS"),
];

/// Each star of a series of which the night has frames.
pub(super) const SERIES_STARS: Table = Table {
    name: "series_stars",
    about: "each star whose flux is measured in a series of frames",
    columns: SERIES_STARS_COLUMNS,
    key: 2,
    from: "series_stars WHERE series IN (SELECT series FROM fluxes WHERE frame_id IN
           (SELECT frame_id FROM images WHERE date_obs >= :from AND date_obs < :to AND telescope IN (:telescope, '')))",
    into: "series_stars",
    ..PLAIN
};

const FLUXES_COLUMNS: &[Column] = &[
    given("frame_id", Kind::Text, "the frame"),
    given("star", Kind::Int, "the star; 0 is the target"),
    given("series", Kind::Text, "frames whose fluxes can be compared"),
    given("x_px", Kind::Real, "column"),
    given("y_px", Kind::Real, "row"),
    given("flux_adu", Kind::Real, "light of the star above the sky"),
    given("error_adu", Kind::Real, "its standard error"),
    given("saturated", Kind::Bool, "a pixel of the star is saturated"),
];

/// Each measured star of each frame.
pub(super) const FLUXES: Table = Table {
    name: "fluxes",
    about: "each measured star of each frame",
    columns: FLUXES_COLUMNS,
    key: 2,
    from: "fluxes WHERE frame_id IN
           (SELECT frame_id FROM images WHERE date_obs >= :from AND date_obs < :to AND telescope IN (:telescope, ''))",
    into: "fluxes",
    ..PLAIN
};
