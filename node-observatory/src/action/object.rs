//! `object`: points at a target and takes frames until the window ends or there are enough.

use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Body, Horizontal, Icrs, Observer};
use units::Utc;

use super::expose::{Series, Shot, adopt, expose, fits};
use super::parameters::{Defocus, LONGEST_S, Metadata, Readout, both, takes_light, yes};
use super::{Action, Exposures, Needs, Place, Stage, Wrong};
use crate::guiding;
use crate::moving::{self, Asked, Elements, Wish};
use crate::names::Found;
use crate::opening;
use crate::plan::{Course, Halt};
use crate::pointing::{self, Flip, Gate, Way};
use crate::rig::telescope::Mount;
use crate::slit::Aimed;
use crate::trouble::Trouble;

/// Points at a target and takes frames until the window ends or there are enough. Without a place nothing is opened or
/// slewed, and frames are taken of whatever the telescope looks at.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Object {
    /// OBJECT keyword, and the name under which guiding remembers the field.
    object: String,
    /// Exposure time.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    exptime: f64,
    /// Right ascension, ICRS; with `dec`.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    ra: Option<f64>,
    /// Declination, ICRS; with `ra`.
    #[schemars(range(min = -90, max = 90), extend("unit" = "deg"))]
    dec: Option<f64>,
    /// Altitude, with `az`, instead of `ra` and `dec`; what stands there when the row begins is then tracked.
    #[schemars(range(min = 0, max = 90), extend("unit" = "deg"))]
    alt: Option<f64>,
    /// Azimuth from north through east; with `alt`.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    az: Option<f64>,
    /// Name of the target: the Moon or a planet, or what Horizons or Sesame know; "TLE" beside `tle`.
    lookup_name: Option<String>,
    /// Two-line elements of a satellite, joined by a newline.
    tle: Option<String>,
    /// Orbital elements of an asteroid or a comet.
    elements: Option<Elements>,
    /// Filter; the one in the beam where absent.
    filter: Option<String>,
    #[serde(flatten)]
    defocus: Defocus,
    /// Frames; absent or negative: until the window ends.
    #[schemars(range(min = -1_000_000_000, max = 1_000_000_000), extend("unit" = "frames"))]
    n: Option<i64>,
    /// Hold the field with guide pulses, where the row moves the telescope.
    #[serde(default)]
    guiding: bool,
    /// Bring the telescope onto the target by solved frames, and count only frames of a row that is proven to be there.
    #[serde(default)]
    pointing: bool,
    /// With `pointing`: frames count although it could not be proven where they look.
    #[serde(default)]
    unverified: bool,
    #[serde(flatten)]
    readout: Readout,
    /// Folder for the files, inside the folder of images.
    dir: Option<String>,
    /// The next rows need not wait for this one.
    #[serde(default)]
    execute_parallel: bool,
    /// Neither open nor slew.
    #[serde(default)]
    disable_telescope_movement: bool,
    /// Forget where another row held this field, and hold it where the first frame shows it.
    #[serde(default = "yes")]
    reset_guiding_reference: bool,
    /// Of a moving target: slew back onto it after so long, between two frames; 0: never.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    nonsidereal_recenter_interval: Option<f64>,
    /// Of a moving target: the telescope waits so long before it.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    nonsidereal_start_lead_time_seconds: Option<f64>,
    /// Of a moving target: rates are renewed no more often than this; absent: 10, less where its path bends fast.
    #[schemars(range(min = 0, max = 3600), extend("unit" = "s"))]
    nonsidereal_rate_update_interval: Option<f64>,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    metadata: Metadata,
}

impl Object {
    fn moves(&self) -> bool {
        let asked = self.asked();
        let is_named = asked.name_to_look_up().is_some() || asked.body().is_ok_and(|body| body.is_some());
        !self.disable_telescope_movement && (asked.has_place || is_named)
    }

    /// What the row says of a target that moves.
    fn asked(&self) -> Asked<'_> {
        Asked {
            lookup_name: self.lookup_name.as_deref(),
            tle: self.tle.as_deref(),
            elements: self.elements.as_ref(),
            has_place: self.ra.is_some() || self.alt.is_some(),
        }
    }

    /// The target, if it is one that moves and is known offline.
    fn body(&self) -> Option<Body> {
        self.asked().body().ok().flatten()
    }

    /// Where to point at an instant, and the target itself where it is one that moves.
    fn goal(&self, stage: &Stage, at: Utc) -> Result<(Option<Icrs>, Option<Body>), Trouble> {
        let body = match self.asked().name_to_look_up() {
            Some(_) if self.disable_telescope_movement => return Ok((None, None)),
            Some(name) => match stage.room.names.borrow().find(name, at)? {
                Found::Place(place) => return Ok((Some(place), None)),
                Found::Body(body) => Some(body),
            },
            None => self.body(),
        };
        match body {
            Some(body) => Ok((Some(body.seen(&stage.observer(at)?)?.icrs), Some(body))),
            None => Ok((self.target(stage, at)?, None)),
        }
    }

    /// The frame that follows `taken` others, if it is wanted and fits into the window.
    fn shot(&self, taken: u32, now: Utc, end: Utc) -> Option<Shot> {
        let wanted = self.frames_wanted();
        if wanted.is_some_and(|wanted| taken >= wanted) || !fits(now, self.exptime, end) {
            return None;
        }
        let of = wanted.map(|wanted| format!(" of {wanted}")).unwrap_or_default();
        let filter = self.filter.as_ref().map(|filter| format!(", {filter}")).unwrap_or_default();
        let words = format!("exposing {}{of}, {} s{filter}", taken + 1, self.exptime);
        Some(Shot { exposure_s: self.exptime, image_type: "Light Frame", words })
    }

    /// Takes the frames of a row whose target moves; where it asks for `pointing`, the telescope is first proven to go where it is
    /// sent beside that target. Returns how many count.
    async fn along(
        &self,
        stage: &Stage,
        mount: &Mount,
        series: Series,
        (mut way, body): (Way, &Body),
        told: &mut Vec<String>,
    ) -> Result<u32, Trouble> {
        if self.guiding {
            told.push("not guided: the target moves among the stars".to_owned());
        }
        let mut wish = Wish {
            lead_s: self.nonsidereal_start_lead_time_seconds.unwrap_or(0.0),
            update_s: self.nonsidereal_rate_update_interval,
            recenter_s: self.nonsidereal_recenter_interval.unwrap_or(0.0),
            correction: None,
        };
        if self.pointing {
            match pointing::acquire(stage, mount, &series, &mut way).await {
                Ok(_) => {
                    let (commanded, target) = (way.commanded, way.target);
                    let ra = (commanded.ra - target.ra).wrapped_signed();
                    wish.correction = Some([ra, commanded.dec - target.dec]);
                }
                Err(Trouble::Unproven { why, .. }) if self.may_be_unproven(stage) => told.push(why),
                Err(trouble) => return Err(trouble),
            }
        }
        moving::observe(stage, mount, (body, &wish), series, |taken, now, end| self.shot(taken, now, end)).await
    }

    /// Takes the frames of a row that has slewed to its target; where it asks for `pointing`, only while the telescope is
    /// proven to be there. Returns how many count.
    async fn proven(
        &self,
        stage: &Stage,
        mount: &Mount,
        series: &Series,
        mut way: Way,
        told: &mut Vec<String>,
    ) -> Result<u32, Trouble> {
        let end = stage.row.end;
        let mut flip = Flip::of(stage, mount);
        loop {
            let mut gate = Gate::learning(stage, mount, way.target, Some(way.commanded));
            if self.pointing {
                match pointing::acquire(stage, mount, series, &mut way).await {
                    Ok(_) => gate = Gate::proven(stage, mount, way.target),
                    Err(Trouble::Unproven { why, .. }) if self.may_be_unproven(stage) => {
                        gate = Gate::learning(stage, mount, way.target, None);
                        tracing::warn!(object = self.object, why, "frames are taken all the same");
                        told.push(why);
                    }
                    Err(trouble) => return Err(trouble),
                }
            }
            let target = way.target;
            let next = |taken, now| match gate.lost() {
                Some(_) => None,
                None if flip.is_due(&target, self.exptime, now) => None,
                None => self.shot(taken, now, end),
            };
            let guided = match self.guiding {
                true => Some(guiding::begin(stage, self.guide_on(Some(way.target))).await?),
                false => None,
            };
            let exposing = expose(stage, series, next);
            match &guided {
                Some(guided) => tokio::select! {
                    taken = exposing => taken?,
                    trouble = guided.given_up() => return Err(trouble),
                },
                None => exposing.await?,
            };
            gate.settle().await?;
            told.extend(guided.map(|guided| guided.told()));
            let taken = stage.room.journal.progress(&stage.row.id).taken;
            let (lost, now) = (gate.lost().map(str::to_owned), stage.clock().utc());
            if self.shot(taken, now, end).is_none() {
                return Ok(taken);
            }
            if flip.is_due(&target, self.exptime, now) {
                stage.step("meridian flip");
                way.commanded = pointing::send(stage, mount, &target).await?;
                way.is_fresh = true;
                way.renew(stage);
                if let Some(ignored) = flip.note().await {
                    tracing::warn!(object = self.object, ignored);
                    told.push(ignored);
                }
                continue;
            }
            let Some(why) = lost else { return Ok(taken) };
            stage.step(format!("back to the target: {why}"));
            if gate.is_proven() {
                way.renew(stage);
            }
            way.again(stage, mount).await?;
        }
    }

    /// How it went: nothing where all was taken.
    fn told(&self, taken: u32) -> String {
        let is_short = self.frames_wanted().is_some_and(|wanted| taken < wanted);
        if is_short { format!("the window ended after {taken} frames") } else { String::new() }
    }

    fn may_be_unproven(&self, stage: &Stage) -> bool {
        self.unverified || stage.room.node.config.pointing.on_failure == config::OnFailure::Observe
    }

    /// What was asked for and is not done, in words.
    fn not_done(&self) -> Vec<&'static str> {
        let guiding = self.guiding && !self.moves();
        let guiding = guiding.then_some("not guided: the row does not move the telescope");
        let cannot = "pointing is left out: the row has no target, or may not move the telescope";
        let pointing = (self.pointing && !self.moves()).then_some(cannot);
        pointing.into_iter().chain(guiding).collect()
    }

    /// What is to be guided on.
    fn guide_on(&self, target: Option<Icrs>) -> guiding::Wanted {
        guiding::Wanted {
            object: self.object.clone(),
            exposure_s: self.exptime,
            target_deg: target.map(|target| [target.ra.degrees(), target.dec.degrees()]),
            reset_reference: self.reset_guiding_reference,
        }
    }

    /// Where to point, at an instant.
    fn target(&self, stage: &Stage, at: Utc) -> Result<Option<Icrs>, Trouble> {
        match (self.ra, self.dec, self.alt, self.az) {
            (Some(ra), Some(dec), ..) => Ok(Some(Icrs::from_degrees(ra, dec).checked()?)),
            (_, _, Some(alt), Some(az)) => Ok(Some(stage.observer(at)?.to_icrs(&Horizontal::from_degrees(alt, az)))),
            _ => Ok(None),
        }
    }
}

impl Action for Object {
    const NAME: &'static str = "object";
    const EXAMPLE: &'static str =
        r#"{"object": "TRAPPIST-1", "exptime": 30, "ra": 346.6223, "dec": -5.0413, "filter": "V", "n": 100}"#;

    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        if self.n == Some(0) {
            return Err(Wrong::of("n", "0 frames; expected 1 or more, or leave n out for as many as the window takes"));
        }
        self.asked().body()?;
        both("ra", self.ra.is_some(), "dec", self.dec.is_some())?;
        both("alt", self.alt.is_some(), "az", self.az.is_some())?;
        if self.ra.is_some() && self.alt.is_some() {
            return Err(Wrong::of("alt", "give ra and dec, or alt and az, not both"));
        }
        Ok(())
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: self.moves(), parallel: self.execute_parallel, all_before: false }
    }

    fn object(&self) -> Option<&str> {
        Some(&self.object)
    }

    fn frames_wanted(&self) -> Option<u32> {
        self.n.and_then(|n| u32::try_from(n).ok())
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        match (self.ra, self.dec) {
            _ if !self.moves() => None,
            _ if self.body().is_some() => {
                let seen = self.body()?.seen(sky).ok()?;
                Some(sky.to_horizontal(&seen.icrs).azimuth.degrees())
            }
            (Some(ra), Some(dec)) => Some(sky.to_horizontal(&Icrs::from_degrees(ra, dec)).azimuth.degrees()),
            _ => self.az,
        }
    }

    fn lookup_name(&self) -> Option<&str> {
        self.asked().name_to_look_up().filter(|_| self.moves())
    }

    fn looks_at(&self) -> Option<Place> {
        if let Some(body) = self.body() {
            return Some(Place::Moving(body));
        }
        match (self.ra, self.dec, self.alt, self.az) {
            (Some(ra), Some(dec), ..) => Some(Place::Icrs(Icrs::from_degrees(ra, dec))),
            (_, _, Some(alt), Some(az)) => Some(Place::Horizontal(Horizontal::from_degrees(alt, az))),
            _ => None,
        }
    }

    fn exposures(&self) -> Vec<Exposures> {
        vec![Exposures::of(self.exptime, self.frames_wanted())]
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        self.not_done().into_iter().for_each(|word| course.tell(word));
        let target = match self.looks_at().filter(|_| self.moves()) {
            Some(place) => Some(course.place(&place)?),
            None => None,
        };
        if let Some(name) = Action::lookup_name(self) {
            course.tell(format!("where {name} stands is looked up when the row is near: no altitude here"));
        }
        course.begin(self.moves().then_some(target.as_ref()), self.filter.as_deref())?;
        course.reads(&self.readout);
        let mut end = course.row.end;
        if let Some(body) = self.body().filter(|_| self.moves()) {
            let (from, lead_s) = (course.now, self.nonsidereal_start_lead_time_seconds.unwrap_or(0.0));
            let outlook = course.outlook();
            end = moving::up_until(&body, (from, end), &outlook, |at| course.observer(at), Halt::Failed)?;
            course.pass(lead_s)?;
        } else if let Some(target) = &target {
            course.ends_out_of_reach(target)?;
        }
        let can_turn = target.filter(|_| self.body().is_none());
        loop {
            if self.pointing && self.moves() {
                course.acquire()?;
            }
            course.expose(|course| match &can_turn {
                Some(target) if course.flip_is_due(target, self.exptime) => None,
                _ => self.shot(course.taken, course.now, end),
            })?;
            if self.shot(course.taken, course.now, end).is_none() {
                break;
            }
            course.turn_over()?;
        }
        course.tell(self.told(course.taken));
        Ok(())
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mut told: Vec<String> = self.not_done().into_iter().map(str::to_owned).collect();
        for word in &told {
            tracing::warn!(object = self.object, "{word}");
        }
        chain.camera.start_cooling().await?;
        // what was learnt since may lead the slew a little beside where that frame looks
        adopt(stage, self.moves()).await?;
        let (target, body) = self.goal(stage, stage.clock().utc())?;
        let pointed = target.filter(|_| self.moves()).zip(chain.mount);
        // the slit goes there beside the mount
        let _aimed = pointed.map(|(target, mount)| Aimed::at(&stage.room, mount, target));

        let point = async {
            let Some(target) = target.filter(|_| self.moves()) else { return Ok(None) };
            let mount = chain.mount.ok_or_else(|| Trouble::Impossible(format!("{} has no mount", stage.row.camera)))?;
            stage.visible(&target)?;
            if body.is_some() {
                moving::can_follow(mount).await?;
            }
            stage.step("opening");
            opening::open(&stage.room, &chain).await?;
            stage.step("slewing");
            let commanded = pointing::send(stage, mount, &target).await?;
            Ok(Some((mount, Way::begun(stage, target, commanded, self.exptime))))
        };
        let (way, ()) = tokio::try_join!(point, stage.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        stage.step("cooling");
        stage.cool().await?;

        let series = Series {
            action: None,
            focus: chain.focuser.is_some().then(|| self.defocus.wanted()),
            object: Some(self.object.clone()),
            target_deg: target.map(|target| (target.ra.degrees(), target.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: self.readout.on(chain.camera).await?,
            folder: self.dir.clone(),
            open_sky: self.moves(),
            metadata: self.metadata.texts(),
        };
        let taken = match (way, &body) {
            (Some((mount, way)), Some(body)) => self.along(stage, mount, series, (way, body), &mut told).await?,
            (Some((mount, way)), None) => self.proven(stage, mount, &series, way, &mut told).await?,
            (None, _) => expose(stage, &series, |taken, now| self.shot(taken, now, stage.row.end)).await?,
        };
        if let Some(mount) = chain.mount.filter(|_| self.moves()) {
            mount.track(false).await?;
        }
        told.push(self.told(taken));
        told.retain(|words| !words.is_empty());
        Ok(told.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(extra: &str) -> Object {
        crate::action::read_text(&format!(r#"{{"object": "x", "exptime": 60{extra}}}"#)).unwrap()
    }

    fn at(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn frames_are_taken_until_there_are_enough_or_the_window_ends() {
        let (now, end) = (at("2026-11-21T03:00:00Z"), at("2026-11-21T03:30:00Z"));
        let ten = object(r#", "n": 10, "filter": "V""#);
        assert_eq!(ten.shot(2, now, end).unwrap().words, "exposing 3 of 10, 60 s, V");
        assert_eq!(ten.shot(10, now, end), None);
        let endless = object(r#", "n": -1"#);
        assert!(endless.shot(5000, now, end).is_some());
        assert_eq!(endless.shot(5000, at("2026-11-21T03:29:01Z"), end), None);
        let none = crate::action::read_text::<Object>(r#"{"object": "x", "exptime": 60, "n": 0}"#).unwrap_err();
        assert!(none.to_string().contains("0 frames"), "{none}");
        let dark = crate::action::read_text::<Object>(r#"{"object": "x", "exptime": 0}"#).unwrap_err();
        assert!(dark.to_string().contains("takes no light"), "{dark}");
    }

    #[test]
    fn without_a_place_or_without_leave_to_move_the_mount_stays() {
        assert!(object(r#", "ra": 1, "dec": 2"#).needs().mount);
        assert!(!object(r#", "ra": 1, "dec": 2, "disable_telescope_movement": true"#).needs().mount);
        assert!(!object("").needs().mount);
    }

    #[test]
    fn what_is_not_built_is_said() {
        let still = object(r#", "guiding": true"#);
        assert_eq!(still.not_done(), ["not guided: the row does not move the telescope"]);
        assert_eq!(object(r#", "guiding": true, "ra": 1, "dec": 2"#).not_done().len(), 0);
        assert_eq!(object(r#", "pointing": true"#).not_done().len(), 1);
        assert_eq!(object(r#", "guiding": true, "pointing": true"#).not_done().len(), 2);
        assert_eq!(object(r#", "pointing": true, "ra": 1, "dec": 2"#).not_done().len(), 0);
        assert_eq!(object("").not_done().len(), 0);
    }
}
