//! Everything that is stored of a night, for its report.

use std::collections::HashSet;

use contract::device::camera::Frame;
use contract::observatory::{FocusRun, RowState};
use report::events::{
    AlertRecord, Doing, FluxRecord, FocusRecord, FrameRecord, GuideRecord, Held, NightEvents, OrderRecord, RowChange,
    Timed,
};
use rusqlite::{Row, params};
use serde::de::DeserializeOwned;
use units::Utc;

use super::{GuidedFrame, Reader, Unreadable, json, time};
use crate::database::{DatabaseError, stamp};
use crate::night::{Night, NightFrame};

/// What [`alert`] reads: the alerts that stood from `?1` to `?2`, of the telescope `?3`.
pub(super) const ALERTS: &str = "SELECT id, priority, raised, cleared, cause, acknowledged_by FROM alerts
    WHERE raised < ?2 AND (cleared IS NULL AND last >= ?1 OR cleared >= ?1) AND telescope IN (?3, '')";

impl Reader {
    /// Everything that is stored of a night until `now`.
    pub fn night_events(&self, night: &Night, now: Utc) -> Result<NightEvents, DatabaseError> {
        let mut unreadable = Unreadable::new();
        let frames = self.readable_frames((night.from, night.to), &mut unreadable)?;
        let _snapshot = self.snapshot()?;
        let mut events = NightEvents::new(night.from, night.to, now);
        events.night = night.date.to_string();
        events.frames = frames.iter().map(frame).collect();
        events.guiding = self.guide_records(&frames)?;
        events.doings = self.held("night", night, &mut unreadable)?;
        events.verdicts = self.held("safety", night, &mut unreadable)?;
        events.schedules = self.held("schedule", night, &mut unreadable)?;
        let (from, to) = (stamp(night.from), stamp(night.to));
        // A row may have been received before the night began; those of other nights are none of its own.
        let sql = "SELECT datetime, row FROM schedule_rows
                   WHERE datetime < ?2 AND ends > ?1 AND starts < ?2 AND telescope IN (?3, '') ORDER BY datetime, seq, number";
        let of = params![from, to, self.telescope];
        events.rows = self.readable(("the row of the schedule of", sql), of, &mut unreadable, |row| {
            Ok(RowChange { at: time(row, 0)?, row: json::<RowState>(row, 1)? })
        })?;
        events.timed = self.timed(&from, &to)?;
        let sql = format!("{ALERTS} ORDER BY raised, id");
        events.alerts = self.readable(("the alert", &sql), of, &mut unreadable, alert)?;
        events.orders = self.list(
            "SELECT datetime, who, verb, outcome FROM audit
             WHERE device = '' AND fault IS NULL AND who <> 'audit' AND who NOT LIKE 'observatory/%'
             AND who NOT LIKE 'device/%' AND who NOT LIKE 'archive/%' AND datetime >= ?1 AND datetime < ?2
             AND instr(node, '/' || ?3 || '/') > 0 ORDER BY datetime, rowid",
            of,
            |row| Ok(OrderRecord { at_utc: time(row, 0)?, from: row.get(1)?, verb: row.get(2)?, outcome: row.get(3)? }),
        )?;
        let sql = "SELECT date_obs, run, outcome FROM focus_runs
                   WHERE date_obs >= ?1 AND date_obs < ?2 AND telescope IN (?3, '') ORDER BY date_obs";
        events.focus = self.readable(("the focus run of", sql), of, &mut unreadable, focus_run)?;
        events.fluxes = self.list(
            "SELECT frame_id, series, star, x_px, y_px, flux_adu, error_adu, saturated
             FROM images JOIN fluxes USING (frame_id)
             WHERE date_obs >= ?1 AND date_obs < ?2 AND telescope IN (?3, '')",
            of,
            |row| {
                Ok(FluxRecord {
                    frame: row.get(0)?,
                    series: row.get(1)?,
                    star: row.get(2)?,
                    x_px: row.get(3)?,
                    y_px: row.get(4)?,
                    flux_adu: row.get(5)?,
                    error_adu: row.get(6)?,
                    is_saturated: row.get(7)?,
                })
            },
        )?;
        events.unreadable = unreadable.into_iter().map(|(what, error)| format!("{what}: {error}")).collect();
        Ok(events)
    }

    /// The guided frames that held the targets of these, each once for an object: two cameras may have exposed meanwhile.
    fn guide_records(&self, frames: &[NightFrame]) -> Result<Vec<GuideRecord>, DatabaseError> {
        let frames = frames.iter().map(|night| &night.image.frame);
        let targets: Vec<&Frame> = frames.filter(|frame| frame.purpose.action == "object").collect();
        let mut known = HashSet::new();
        let held = self.guided_frames_of(&self.telescope, &targets)?.into_iter();
        let records = held.filter_map(|(place, GuidedFrame { id, camera, bin, off_px })| {
            let object = &targets.get(place)?.purpose.object;
            known.insert((object, id)).then(|| GuideRecord { object: object.clone(), camera, bin, off_px })
        });
        Ok(records.collect())
    }

    /// The newest state of the observatory node that can be read, of those that began before an instant; absent where none
    /// was stored.
    pub fn newest_doing(&self, before: Option<Utc>) -> Result<Option<Held<Doing>>, DatabaseError> {
        let before = before.map_or("~".to_owned(), stamp);
        let sql = "SELECT datetime, last, boot_id, seq, state FROM states
                   WHERE part = 'night' AND datetime <= ?1 AND telescope IN (?2, '') ORDER BY datetime DESC LIMIT 20";
        let of = params![before, self.telescope];
        Ok(self.readable(("a state of", sql), of, &mut Unreadable::new(), held)?.into_iter().next())
    }

    /// Was a frame taken or an action under way in a night?
    pub fn has_happened(&self, night: &Night) -> Result<bool, DatabaseError> {
        let actions = "SELECT EXISTS (SELECT 1 FROM states WHERE part = 'night' AND datetime >= ?1 AND datetime < ?2
                       AND telescope IN (?3, '') AND iif(json_valid(state), json_array_length(state, '$.actions') > 0, 0))";
        let of = params![stamp(night.from), stamp(night.to), self.telescope];
        let has_actions = self.list(actions, of, |row| row.get::<_, bool>(0))?.contains(&true);
        Ok(has_actions || self.count_frames(night.from, night.to)? > 0)
    }

    /// Is anything known of a night: a frame, or what the observatory node did?
    pub fn is_recorded(&self, night: &Night) -> Result<bool, DatabaseError> {
        // A state lasts while it is the same, such as closed for days; the newest of them lasted longest.
        let state = "SELECT last >= ?1 FROM states WHERE part = 'night' AND datetime < ?2 AND telescope IN (?3, '')
                     ORDER BY datetime DESC LIMIT 1";
        let of = params![stamp(night.from), stamp(night.to), self.telescope];
        let has_state = self.list(state, of, |row| row.get::<_, bool>(0))?.contains(&true);
        Ok(has_state || self.count_frames(night.from, night.to)? > 0)
    }

    /// When something began that was stored or changed since an instant although it had begun before: frames and facts that came
    /// late, and alerts that were cleared late.
    pub(crate) fn late_changes(&self, since: Utc) -> Result<Vec<Utc>, DatabaseError> {
        let sql = "SELECT date_obs FROM images WHERE date_obs < ?1 AND stored >= ?1 AND telescope IN (?2, '')
                   UNION SELECT date_obs FROM facts WHERE date_obs < ?1 AND datetime >= ?1 AND telescope IN (?2, '')
                   UNION SELECT raised FROM alerts WHERE raised < ?1 AND cleared >= ?1 AND telescope IN (?2, '')";
        self.list(sql, params![stamp(since), self.telescope], |row| time(row, 0))
    }

    /// Solved frames of targets whose stars were not measured for a light curve, the oldest first.
    pub(crate) fn unmeasured_targets(&self, since: Utc, limit: u32) -> Result<Vec<NightFrame>, DatabaseError> {
        let images = self.images(
            "JOIN facts USING (frame_id) WHERE images.date_obs >= ?1 AND facts.ra_deg IS NOT NULL
             AND frame_id NOT IN (SELECT frame_id FROM fluxes) AND frame ->> '$.purpose.action' = 'object'
             AND frame ->> '$.purpose.image_type' = 'Light Frame' AND images.telescope IN (?3, '')
             ORDER BY images.date_obs LIMIT ?2",
            params![stamp(since), limit, self.telescope],
        )?;
        let with_facts = images.into_iter().map(|image| {
            let facts = self.facts(&image.frame.id)?.map(|stored| stored.facts);
            Ok(NightFrame { image, is_complete: false, facts })
        });
        with_facts.collect()
    }

    /// Where the stars of a series are, ICRS degrees, the target first; none where it is new.
    pub(crate) fn series_stars(&self, series: &str) -> Result<Vec<[f64; 2]>, DatabaseError> {
        let sql = "SELECT ra_deg, dec_deg FROM series_stars WHERE series = ? ORDER BY star";
        self.list(sql, params![series], |row| Ok([row.get(0)?, row.get(1)?]))
    }

    fn held<T: DeserializeOwned>(
        &self,
        part: &str,
        night: &Night,
        unreadable: &mut Unreadable,
    ) -> Result<Vec<Held<T>>, DatabaseError> {
        let sql = "SELECT datetime, last, boot_id, seq, state FROM states
                   WHERE part = ?1 AND datetime < ?3 AND last >= ?2 AND telescope IN (?4, '') ORDER BY datetime, seq";
        let of = params![part, stamp(night.from), stamp(night.to), self.telescope];
        self.readable((&format!("the state `{part}` of"), sql), of, unreadable, held)
    }

    /// The durations that the observatory node writes into its diary.
    fn timed(&self, from: &str, to: &str) -> Result<Vec<Timed>, DatabaseError> {
        let lines: Vec<(Utc, String)> = self.list(
            "SELECT datetime, message FROM log WHERE datetime >= ?1 AND datetime < ?2 AND message LIKE 'took %'
             AND target LIKE 'node_observatory%' AND telescope = ?3",
            params![from, to, self.telescope],
            |row| Ok((time(row, 0)?, row.get(1)?)),
        )?;
        let read = |(until, line): (Utc, String)| {
            let field = |name: &str| line.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
            let took_s: f64 = field("took_s")?.parse().ok()?;
            Some(Timed { until, took_s: took_s.clamp(0.0, 86_400.0), part: field("span")?.to_owned() })
        };
        Ok(lines.into_iter().filter_map(read).collect())
    }
}

fn held<T: DeserializeOwned>(row: &Row<'_>) -> rusqlite::Result<Held<T>> {
    let seq = row.get::<_, i64>(3)?.unsigned_abs();
    Ok(Held { from: time(row, 0)?, until: time(row, 1)?, boot: row.get(2)?, seq, state: json(row, 4)? })
}

pub(super) fn alert(row: &Row<'_>) -> rusqlite::Result<AlertRecord> {
    Ok(AlertRecord {
        id: row.get(0)?,
        priority: row.get(1)?,
        raised_utc: time(row, 2)?,
        cleared_utc: row.get::<_, Option<String>>(3)?.map(|_| time(row, 3)).transpose()?,
        cause: row.get(4)?,
        acknowledged_by: row.get(5)?,
    })
}

fn focus_run(row: &Row<'_>) -> rusqlite::Result<FocusRecord> {
    let run: FocusRun = json(row, 1)?;
    Ok(FocusRecord {
        started_utc: run.started_utc,
        camera: run.camera,
        filter: run.filter,
        outcome: row.get(2)?,
        reason: run.reason,
        best_position: run.best_position,
        best_position_error: run.best_position_error,
    })
}

fn frame(night: &NightFrame) -> FrameRecord {
    let NightFrame { image, is_complete, facts } = night;
    let (frame, purpose) = (&image.frame, &image.frame.purpose);
    let facts = facts.as_ref();
    FrameRecord {
        id: frame.id.0.clone(),
        file: image.file.clone(),
        camera: frame.camera.clone(),
        action: purpose.action.clone(),
        image_type: purpose.image_type.clone(),
        object: purpose.object.clone(),
        filter: purpose.filter.clone(),
        row: purpose.row,
        started: frame.started_utc,
        exposure_s: frame.exposure_s,
        bin: frame.bin,
        bytes: image.bytes,
        is_complete: *is_complete,
        refused: facts.and_then(|facts| facts.refused.clone()),
        unmeasured: facts.and_then(|facts| facts.reason.clone()),
        is_solved: facts.is_some_and(|facts| facts.wcs.is_some()),
        fwhm_px: facts.and_then(|facts| facts.fwhm_px),
        scale_arcsec_px: facts.and_then(|facts| facts.scale_arcsec_px),
        ellipticity: facts.and_then(|facts| facts.ellipticity),
        sky_adu: facts.and_then(|facts| facts.sky_adu),
        transparency: facts.and_then(|facts| facts.transparency),
        off_target_arcmin: facts.and_then(|facts| facts.off_target_arcmin),
        airmass: facts.and_then(|facts| facts.airmass),
    }
}
