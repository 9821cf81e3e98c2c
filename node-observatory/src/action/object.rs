//! `object`: points at a target and takes frames until the window ends or there are enough.

use schedule::action::{Object, Parameters as _};
use schedule::names::Found;
use schedule::plan::TimedPart;
use sky::{Body, Horizontal, Icrs};
use units::Utc;

use super::{Execute, Techniques, read_out};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::exposing::{Series, adopt};
use crate::focus::expose_in_focus;
use crate::guiding;
use crate::moving::{self, FollowRequest};
use crate::opening;
use crate::pointing::{self, Acquisition, Flip, Gate};
use crate::row_context::RowContext;
use crate::slit::Aimed;

/// A mount that leaves its place so often, with no frame in between that counts, is a fault of the mount.
const LOSSES: u32 = 3;

impl Execute for Object {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let chain = context.chain()?;
        let mut report: Vec<String> = self.not_done().into_iter().map(str::to_owned).collect();
        for word in &report {
            tracing::warn!(object = self.object, "{word}");
        }
        chain.camera.start_cooling().await?;
        // The solutions since then may lead the slew a little away from the place of that frame.
        adopt(context, self.moves()).await?;
        let had = context.tools.journal.progress(&context.row.id).taken;
        if self.frames_wanted().is_some_and(|wanted| had >= wanted) {
            // All were taken before a restart: nothing is moved for them any more.
            if self.moves() {
                context.leave_mount();
            }
            return Ok(self.summary(had));
        }
        let (target, body) = goal(self, context, techniques, context.clock().utc())?;
        let pointed = target.filter(|_| self.moves()).zip(chain.mount);
        // The slit goes there while the mount slews.
        let _aimed = pointed.map(|(target, mount)| Aimed::at(&context.tools.slits, mount, target));

        let point = async {
            let Some(target) = target.filter(|_| self.moves()) else { return Ok(None) };
            let mount =
                chain.mount.ok_or_else(|| ActionError::Impossible(format!("{} has no mount", context.row.camera)))?;
            context.visible(&target)?;
            if body.is_some() {
                moving::can_follow(mount).await?;
            }
            context.step("opening", TimedPart::Open);
            opening::open(&techniques.opener, &chain).await?;
            context.step("slewing", TimedPart::Slew);
            let commanded = pointing::send(context, &techniques.pointing, mount, &target).await?;
            Ok(Some((mount, Acquisition::begun(context, target, commanded, self.exptime))))
        };
        let (way, ()) =
            tokio::try_join!(point, context.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;

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
            (Some((mount, way)), Some(body)) => {
                along(self, context, techniques, mount, series, (way, body), &mut report).await?
            }
            (Some((mount, way)), None) => proven(self, context, techniques, mount, &series, way, &mut report).await?,
            (None, _) => {
                expose_in_focus(context, &techniques.focus, &series, |taken, now| {
                    self.shot(taken, context.tools.authority.surely(now), context.row.end)
                })
                .await?
            }
        };
        if self.moves() {
            context.leave_mount();
        }
        report.push(self.summary(taken));
        report.retain(|words| !words.is_empty());
        Ok(report.join("; "))
    }
}

/// Where to point at an instant, and the target itself where it is one that moves.
fn goal(
    object: &Object,
    context: &RowContext,
    techniques: &Techniques,
    at: Utc,
) -> Result<(Option<Icrs>, Option<Body>), ActionError> {
    let body = match object.asked().name_to_look_up() {
        Some(_) if object.disable_telescope_movement => return Ok((None, None)),
        Some(name) => match techniques.names.borrow().find(name, at).map_err(ActionError::Unnamed)? {
            Found::Place(place) => return Ok((Some(place), None)),
            Found::Body(body) => Some(body),
        },
        None => object.body(),
    };
    match body {
        Some(body) => Ok((Some(body.seen(&context.observer(at)?)?.icrs), Some(body))),
        None => Ok((target(object, context, at)?, None)),
    }
}

/// Takes the frames of a row whose target moves. If the row asks for `pointing`, the node first proves on a place near
/// that target that the telescope goes where it is sent. Returns how many frames count.
async fn along(
    object: &Object,
    context: &RowContext,
    techniques: &Techniques,
    mount: &Mount,
    series: Series,
    (mut way, body): (Acquisition, &Body),
    report: &mut Vec<String>,
) -> Result<u32, ActionError> {
    if object.guiding {
        report.push("not guided: the target moves among the stars".to_owned());
    }
    let mut request = FollowRequest {
        lead_s: object.nonsidereal_start_lead_time_seconds.unwrap_or(0.0),
        update_s: object.nonsidereal_rate_update_interval,
        recenter_s: object.nonsidereal_recenter_interval.unwrap_or(0.0),
        correction: None,
    };
    if object.pointing {
        match pointing::acquire(context, &techniques.pointing, mount, &series, &mut way).await {
            Ok(_) => {
                let (commanded, target) = (way.commanded, way.target);
                let ra = (commanded.ra - target.ra).wrapped_signed();
                request.correction = Some([ra, commanded.dec - target.dec]);
            }
            Err(ActionError::Unproven { why, .. }) if may_be_unproven(object, context) => report.push(why),
            Err(error) => return Err(error),
        }
    }
    moving::observe(
        context,
        (&techniques.pointing, &techniques.focus),
        mount,
        (body, &request),
        series,
        |taken, now, end| object.shot(taken, context.tools.authority.surely(now), end),
    )
    .await
}

/// Takes the frames of a row that has slewed to its target; where it asks for `pointing`, only while the telescope is
/// proven to be there. Returns how many count.
async fn proven(
    object: &Object,
    context: &RowContext,
    techniques: &Techniques,
    mount: &Mount,
    series: &Series,
    mut way: Acquisition,
    report: &mut Vec<String>,
) -> Result<u32, ActionError> {
    let end = context.row.end;
    let mut flip = Flip::of(context, mount);
    let (mut losses, mut had) = (0, context.tools.journal.progress(&context.row.id).taken);
    loop {
        let mut gate = Gate::learning(context, &techniques.pointing, mount, way.target, Some(way.commanded))
            .guided(object.guiding);
        if object.pointing {
            match pointing::acquire(context, &techniques.pointing, mount, series, &mut way).await {
                Ok(_) => {
                    gate = Gate::proven(context, &techniques.pointing, mount, way.target).guided(object.guiding);
                }
                Err(ActionError::Unproven { why, .. }) if may_be_unproven(object, context) => {
                    gate =
                        Gate::learning(context, &techniques.pointing, mount, way.target, None).guided(object.guiding);
                    tracing::warn!(object = object.object, why, "frames are taken all the same");
                    report.push(why);
                }
                Err(error) => return Err(error),
            }
        }
        let target = way.target;
        let next = |taken, now| match gate.lost() {
            Some(_) => None,
            None if flip.is_due(&target, object.exptime, now) => None,
            None => object.shot(taken, context.tools.authority.surely(now), end),
        };
        let guided = match object.guiding {
            true => Some(guiding::begin(context, &techniques.guiding, guide_on(object, Some(way.target))).await?),
            false => None,
        };
        let exposing = expose_in_focus(context, &techniques.focus, series, next);
        match &guided {
            Some(guided) => tokio::select! {
                taken = exposing => taken?,
                error = guided.given_up() => return Err(error),
            },
            None => exposing.await?,
        };
        gate.settle().await?;
        if let Some(guided) = &guided {
            guided.settle(context).await;
        }
        report.extend(guided.map(|guided| guided.summary()));
        let taken = context.tools.journal.progress(&context.row.id).taken;
        let (lost, now) = (gate.lost().map(str::to_owned), context.clock().utc());
        if object.shot(taken, context.tools.authority.surely(now), end).is_none() {
            return Ok(taken);
        }
        if flip.is_due(&target, object.exptime, now) {
            context.step("meridian flip", TimedPart::Slew);
            let side = flip.side();
            way.commanded = pointing::send(context, &techniques.pointing, mount, &target).await?;
            way.is_fresh = true;
            way.renew(context);
            if let Some(side) = side
                && let Some(ignored) = flip.note(side).await
            {
                tracing::warn!(object = object.object, ignored);
                report.push(ignored);
            }
            continue;
        }
        let Some(why) = lost else { return Ok(taken) };
        losses = if taken > had { 1 } else { losses + 1 };
        had = taken;
        if gate.has_left() {
            if losses >= LOSSES {
                let (device, verb) = (mount.instrument.device.to_string(), "stay at its target".to_owned());
                return Err(ActionError::Failed { device, verb, reason: why });
            }
            // It may stand and say that it tracks.
            mount.track_anew().await;
        }
        context.step(format!("back to the target: {why}"), TimedPart::Slew);
        if gate.is_proven() {
            way.renew(context);
        }
        way.again(context, mount).await?;
    }
}

fn may_be_unproven(object: &Object, context: &RowContext) -> bool {
    object.unverified || context.tools.authority.node.config.pointing.on_failure == config::OnFailure::Observe
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
fn target(object: &Object, context: &RowContext, at: Utc) -> Result<Option<Icrs>, ActionError> {
    match (object.ra, object.dec, object.alt, object.az) {
        (Some(ra), Some(dec), ..) => Ok(Some(Icrs::from_degrees(ra, dec).checked()?)),
        (_, _, Some(alt), Some(az)) => Ok(Some(context.observer(at)?.to_icrs(&Horizontal::from_degrees(alt, az)))),
        _ => Ok(None),
    }
}
