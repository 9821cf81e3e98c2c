//! Focus runs and their points.

use super::{given, maybe};
use crate::table::{Column, Kind, Table};

const FOCUS_RUNS_COLUMNS: &[Column] = &[
    given("run_id", Kind::Text, "the focus run"),
    given("camera_name", Kind::Text, "the camera"),
    given("focuser_name", Kind::Text, "the focuser"),
    maybe("filter", Kind::Text, "the filter"),
    given("date_obs", Kind::Stamp, "when the run began"),
    maybe("ended", Kind::Stamp, "when it ended"),
    given("outcome", Kind::Text, "how it ended"),
    maybe("reason", Kind::Text, "why it ended so"),
    given("start_position", Kind::Int, "position before the run, steps"),
    maybe("best_position", Kind::Real, "the focus, steps"),
    maybe("best_position_error", Kind::Real, "its error, steps"),
    maybe("stored_position", Kind::Real, "the position that was stored, steps"),
    maybe("critical_zone", Kind::Real, "how far the focuser may be off, steps"),
    maybe("verified", Kind::Real, "measured at the focus"),
    given("operator", Kind::Text, "what was measured"),
    maybe("temperature_c", Kind::Real, "of the focuser or the air"),
    maybe("altitude_deg", Kind::Real, "of the telescope"),
    given("plot", Kind::Text, "the plot, relative to the folder of images"),
    given("run", Kind::Text, "the whole run, as JSON"),
    given("datetime", Kind::Stamp, "when it was published"),
    given("boot_id", Kind::Text, "incarnation of the node that published it"),
    given("seq", Kind::Int, "number of the sample"),
];

/// Each focus run.
pub(super) const FOCUS_RUNS: Table = Table {
    name: "focus_runs",
    about: "each focus run",
    columns: FOCUS_RUNS_COLUMNS,
    key: 1,
    group: 0,
    prefer: None,
    from: "focus_runs WHERE date_obs >= :from AND date_obs < :to AND telescope IN (:telescope, '')",
    next: Some("SELECT min(date_obs) FROM focus_runs WHERE date_obs >= :from AND telescope IN (:telescope, '')"),
    insert: None,
    into: "focus_runs",
    owner: Some("telescope"),
    before: None,
};

const FOCUS_POINTS_COLUMNS: &[Column] = &[
    given("run_id", Kind::Text, "the focus run"),
    given("number", Kind::Int, "of the point, in the order of time"),
    given("position", Kind::Int, "of the focuser, steps"),
    given("pass", Kind::Text, "part of the run"),
    maybe("value", Kind::Real, "what was measured"),
    maybe("error", Kind::Real, "its error"),
    maybe("stars", Kind::Int, "stars that were measured"),
    maybe("reason", Kind::Text, "why there is no value"),
    maybe("temperature_c", Kind::Real, "of the focuser or the air"),
    maybe("used", Kind::Bool, "the point counts for the focus"),
];

/// Each position of a focus run.
pub(super) const FOCUS_POINTS: Table = Table {
    name: "focus_points",
    about: "each position of a focus run",
    columns: FOCUS_POINTS_COLUMNS,
    key: 2,
    group: 0,
    prefer: None,
    from: "focus_points WHERE run_id IN (SELECT run_id FROM focus_runs
           WHERE date_obs >= :from AND date_obs < :to AND telescope IN (:telescope, ''))",
    next: None,
    insert: None,
    into: "focus_points",
    owner: None,
    before: None,
};
