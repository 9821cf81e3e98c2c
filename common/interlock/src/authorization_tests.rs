//! Scenarios of commands to a device.

use std::time::Duration;

use contract::BootId;
use contract::device::dome::Shutter;
use contract::observatory::Verdict;

use super::*;
use crate::guard::tests::{at, guard, permit, telescope};
use crate::guard_words::Roofs;
use crate::known_tokens::KnownTokens;
use crate::mount_watch::Calls;

const MAIN: &str = "observatory/alpha/main";

/// What is known where a command arrives: the newest token is 1.
struct Scene {
    leases: Leases,
    guard: Option<Guard>,
    roof: RoofCall,
    is_arbiter: bool,
}

impl Scene {
    /// A closed dome under a permit with this verdict, or under none.
    fn dome(verdict: Option<Verdict>) -> Self {
        let mut guard = guard();
        let number = guard.beat(at(0.0));
        if let Some(verdict) = verdict {
            guard.observe(&telescope("alpha"), &permit(0, number, verdict)).unwrap();
        }
        Self { guard: Some(guard), ..Self::mount() }
    }

    /// One that must close and is not proven closed.
    fn closing() -> Self {
        let mut scene = Self::dome(Some(Verdict::Unsafe));
        let guard = scene.guard.as_mut().unwrap();
        guard.look(at(1.0), Some((Shutter::Open, at(1.0))), true);
        scene
    }

    fn mount() -> Self {
        let (mut tokens, _) = KnownTokens::of([("alpha".to_owned(), 1)].into());
        tokens.arbitrate("alpha");
        Self { leases: Leases::new(tokens), guard: None, roof: RoofCall::default(), is_arbiter: true }
    }

    fn under_a_roof_that_closes(permitted: bool) -> Self {
        let roofs = Roofs { waits: true, closing: true, closed: false };
        Self { roof: RoofCall::of(Calls { permitted, roofs }), is_arbiter: false, ..Self::mount() }
    }

    fn admit(&mut self, need: Need, hinders: Hinders, token: Option<u64>) -> Result<Admitted, Reason> {
        let Self { leases, guard, roof, is_arbiter } = self;
        let mut authorization =
            Authorization { telescope: "alpha", is_arbiter: *is_arbiter, roof: *roof, leases, guard: guard.as_mut() };
        let who = Claimant { name: MAIN, boot_id: None };
        authorization.admit(CommandNeeds { need, hinders, who, token }, at(2.0)).map_err(|(reason, _)| reason)
    }
}

#[test]
fn a_command_passes_by_its_token_the_permit_and_what_a_closing_needs() {
    use Reason::{NoPermit, NotImplemented, StaleToken, WrongState};
    let (safe, bad) = (Some(Verdict::Safe), Some(Verdict::Unsafe));
    let (own, old, none) = (Some(1), Some(0), None);
    let scenarios = [
        ("anyone may stop", Scene::dome(safe), Need::Nothing, Hinders::Yes, none, None),
        ("nobody stops a closing", Scene::closing(), Need::Nothing, Hinders::Yes, own, Some(WrongState)),
        ("the commander may park what closes", Scene::closing(), Need::Nothing, Hinders::FromOthers, own, None),
        ("others may not", Scene::closing(), Need::Nothing, Hinders::FromOthers, old, Some(WrongState)),
        ("anyone may close", Scene::dome(None), Need::Close, Hinders::No, none, None),
        ("the commander opens", Scene::dome(safe), Need::Open, Hinders::No, own, None),
        ("without a permit nobody does", Scene::dome(None), Need::Open, Hinders::No, own, Some(NoPermit)),
        ("nor under an unsafe one", Scene::dome(bad), Need::Open, Hinders::No, own, Some(NoPermit)),
        ("an old token opens nothing", Scene::dome(safe), Need::Open, Hinders::No, old, Some(StaleToken)),
        ("nor does none", Scene::dome(safe), Need::Open, Hinders::No, none, Some(StaleToken)),
        ("nor one never granted", Scene::dome(safe), Need::Open, Hinders::No, Some(2), Some(StaleToken)),
        ("a vendor's command under a permit", Scene::dome(safe), Need::TokenAndPermit, Hinders::No, own, None),
        ("and without", Scene::dome(None), Need::TokenAndPermit, Hinders::No, own, Some(NoPermit)),
        ("what is no dome needs none", Scene::mount(), Need::TokenAndPermit, Hinders::No, own, None),
        ("whoever may park while nobody observes", Scene::mount(), Need::TokenWhileSafe, Hinders::No, none, None),
        ("a resume needs a permit", Scene::dome(None), Need::Resume, Hinders::No, own, Some(NoPermit)),
        ("a slew", Scene::mount(), Need::Token, Hinders::Yes, own, None),
        (
            "a slew under a roof that waits for the park",
            Scene::under_a_roof_that_closes(false),
            Need::Token,
            Hinders::Yes,
            own,
            Some(WrongState),
        ),
        (
            "a commander that does not know of the closing",
            Scene::under_a_roof_that_closes(true),
            Need::Token,
            Hinders::FromTheUnaware,
            own,
            Some(WrongState),
        ),
        (
            "a lease from a device that grants none",
            Scene::under_a_roof_that_closes(false),
            Need::Claim,
            Hinders::No,
            none,
            Some(NotImplemented),
        ),
    ];
    for (name, mut scene, need, hinders, token, refused) in scenarios {
        let expected = refused.map_or(Ok(Admitted::Passes), Err);
        assert_eq!(scene.admit(need, hinders, token), expected, "{name}");
    }
}

#[test]
fn a_guard_knows_of_each_command_that_passes_and_of_none_that_is_refused() {
    let mut scene = Scene::dome(Some(Verdict::Safe));
    let before = scene.guard.clone();
    assert_eq!(scene.admit(Need::Open, Hinders::No, None), Err(Reason::StaleToken));
    assert_eq!(scene.guard, before);
    scene.admit(Need::Open, Hinders::No, Some(1)).unwrap();
    assert_ne!(scene.guard, before, "it expects the shutter to open");
    let before = scene.guard.clone();
    scene.admit(Need::Close, Hinders::No, None).unwrap();
    assert_ne!(scene.guard, before, "and now to close");
}

#[test]
fn a_claim_is_granted_unless_another_process_that_holds_the_lease_has_published() {
    let mut scene = Scene::dome(None);
    let granted = Ok(Admitted::IsGranted { telescope: "alpha".to_owned() });
    assert_eq!(scene.admit(Need::Claim, Hinders::No, None), granted);
    let other = Claimant { name: "observatory/alpha/other", boot_id: Some(&BootId::fresh()) };
    scene.leases.granted("alpha", 2, other, at(1.0));
    assert_eq!(scene.admit(Need::Claim, Hinders::No, None), Err(Reason::LeaseHeld));
    scene.leases.granted("alpha", 2, other, at(2.0).minus(Duration::from_secs(5)));
    assert_eq!(scene.admit(Need::Claim, Hinders::No, None), granted);
}
