//! `object`: points at a target and takes frames until the window ends or there are enough.

use schedule::action::Object;
use schedule::names::Found;
use sky::{Body, Horizontal, Icrs};
use units::Utc;

use super::expose::{Series, adopt, expose};
use super::{Execute, Stage, read_out};
use crate::guiding;
use crate::moving::{self, Wish};
use crate::opening;
use crate::pointing::{self, Flip, Gate, Way};
use crate::rig::telescope::Mount;
use crate::slit::Aimed;
use crate::trouble::Trouble;

impl Execute for Object {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mut told: Vec<String> = self.not_done().into_iter().map(str::to_owned).collect();
        for word in &told {
            tracing::warn!(object = self.object, "{word}");
        }
        chain.camera.start_cooling().await?;
        // The solutions since then may lead the slew a little away from the place of that frame.
        adopt(stage, self.moves()).await?;
        let (target, body) = goal(self, stage, stage.clock().utc())?;
        let pointed = target.filter(|_| self.moves()).zip(chain.mount);
        // The slit goes there while the mount slews.
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
            subframe: read_out(&self.readout, chain.camera).await?,
            folder: self.dir.clone(),
            open_sky: self.moves(),
            metadata: self.metadata.texts(),
        };
        let taken = match (way, &body) {
            (Some((mount, way)), Some(body)) => along(self, stage, mount, series, (way, body), &mut told).await?,
            (Some((mount, way)), None) => proven(self, stage, mount, &series, way, &mut told).await?,
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

/// Where to point at an instant, and the target itself where it is one that moves.
fn goal(object: &Object, stage: &Stage, at: Utc) -> Result<(Option<Icrs>, Option<Body>), Trouble> {
    let body = match object.asked().name_to_look_up() {
        Some(_) if object.disable_telescope_movement => return Ok((None, None)),
        Some(name) => match stage.room.names.borrow().find(name, at).map_err(Trouble::Unnamed)? {
            Found::Place(place) => return Ok((Some(place), None)),
            Found::Body(body) => Some(body),
        },
        None => object.body(),
    };
    match body {
        Some(body) => Ok((Some(body.seen(&stage.observer(at)?)?.icrs), Some(body))),
        None => Ok((target(object, stage, at)?, None)),
    }
}

/// Takes the frames of a row whose target moves. If the row asks for `pointing`, the node first proves on a place near
/// that target that the telescope goes where it is sent. Returns how many frames count.
async fn along(
    object: &Object,
    stage: &Stage,
    mount: &Mount,
    series: Series,
    (mut way, body): (Way, &Body),
    told: &mut Vec<String>,
) -> Result<u32, Trouble> {
    if object.guiding {
        told.push("not guided: the target moves among the stars".to_owned());
    }
    let mut wish = Wish {
        lead_s: object.nonsidereal_start_lead_time_seconds.unwrap_or(0.0),
        update_s: object.nonsidereal_rate_update_interval,
        recenter_s: object.nonsidereal_recenter_interval.unwrap_or(0.0),
        correction: None,
    };
    if object.pointing {
        match pointing::acquire(stage, mount, &series, &mut way).await {
            Ok(_) => {
                let (commanded, target) = (way.commanded, way.target);
                let ra = (commanded.ra - target.ra).wrapped_signed();
                wish.correction = Some([ra, commanded.dec - target.dec]);
            }
            Err(Trouble::Unproven { why, .. }) if may_be_unproven(object, stage) => told.push(why),
            Err(trouble) => return Err(trouble),
        }
    }
    moving::observe(stage, mount, (body, &wish), series, |taken, now, end| object.shot(taken, now, end)).await
}

/// Takes the frames of a row that has slewed to its target; where it asks for `pointing`, only while the telescope is
/// proven to be there. Returns how many count.
async fn proven(
    object: &Object,
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
        if object.pointing {
            match pointing::acquire(stage, mount, series, &mut way).await {
                Ok(_) => gate = Gate::proven(stage, mount, way.target),
                Err(Trouble::Unproven { why, .. }) if may_be_unproven(object, stage) => {
                    gate = Gate::learning(stage, mount, way.target, None);
                    tracing::warn!(object = object.object, why, "frames are taken all the same");
                    told.push(why);
                }
                Err(trouble) => return Err(trouble),
            }
        }
        let target = way.target;
        let next = |taken, now| match gate.lost() {
            Some(_) => None,
            None if flip.is_due(&target, object.exptime, now) => None,
            None => object.shot(taken, now, end),
        };
        let guided = match object.guiding {
            true => Some(guiding::begin(stage, guide_on(object, Some(way.target))).await?),
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
        if object.shot(taken, now, end).is_none() {
            return Ok(taken);
        }
        if flip.is_due(&target, object.exptime, now) {
            stage.step("meridian flip");
            way.commanded = pointing::send(stage, mount, &target).await?;
            way.is_fresh = true;
            way.renew(stage);
            if let Some(ignored) = flip.note().await {
                tracing::warn!(object = object.object, ignored);
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

fn may_be_unproven(object: &Object, stage: &Stage) -> bool {
    object.unverified || stage.room.node.config.pointing.on_failure == config::OnFailure::Observe
}

/// What is to be guided on.
fn guide_on(object: &Object, target: Option<Icrs>) -> guiding::Wanted {
    guiding::Wanted {
        object: object.object.clone(),
        exposure_s: object.exptime,
        target_deg: target.map(|target| [target.ra.degrees(), target.dec.degrees()]),
        reset_reference: object.reset_guiding_reference,
    }
}

/// Where to point, at an instant.
fn target(object: &Object, stage: &Stage, at: Utc) -> Result<Option<Icrs>, Trouble> {
    match (object.ra, object.dec, object.alt, object.az) {
        (Some(ra), Some(dec), ..) => Ok(Some(Icrs::from_degrees(ra, dec).checked()?)),
        (_, _, Some(alt), Some(az)) => Ok(Some(stage.observer(at)?.to_icrs(&Horizontal::from_degrees(alt, az)))),
        _ => Ok(None),
    }
}
