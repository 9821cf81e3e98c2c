use super::super::tests::frame;
use super::*;

fn at(n: usize) -> Utc {
    Utc::from_seconds(1.8e9 + 30.0 * n as f64)
}

/// The nth frame of a row.
fn light(n: usize) -> Frame {
    let mut light = Frame { started_utc: at(n), exposure_s: 25.0, ..frame(&format!("f{n}")) };
    light.purpose.action = "object".to_owned();
    light.purpose.filter = Some("V".to_owned());
    light.purpose.row = Some(1);
    light
}

fn facts(stars: u32, fwhm_px: f64) -> FrameFacts {
    FrameFacts { stars: Some(stars), fwhm_px: Some(fwhm_px), trailed: Some(false), ..FrameFacts::default() }
}

/// The active triggers after each frame of a scenario.
fn triggered(scenario: &[FrameFacts]) -> Vec<Vec<TriggerKind>> {
    let mut triggers = Triggers::default();
    let observe = |(n, facts): (usize, &FrameFacts)| {
        triggers.observe(&light(n), facts);
        triggers.active(at(n)).into_iter().map(|trigger| trigger.kind).collect()
    };
    scenario.iter().enumerate().map(observe).collect()
}

fn kinds(of: &[Option<TriggerKind>]) -> Vec<Vec<TriggerKind>> {
    of.iter().map(|kind| kind.iter().copied().collect()).collect()
}

#[test]
fn stars_that_vanish_are_clouds_until_half_of_them_are_back() {
    let scenario = [100, 90, 110, 31, 29, 0, 49, 51, 29].map(|stars| facts(stars, 3.0));
    let clouds = Some(TriggerKind::Clouds);
    // The 31 are not clouds, and count among the usual from then on: (100, 90, 110, 31) have the median 95.
    assert_eq!(
        triggered(&scenario),
        kinds(&[None, None, None, None, None, clouds, None, None, None]),
        "29 of 95 are more than 30 %"
    );
    let scenario = [100, 100, 100, 29, 0, 49, 51].map(|stars| facts(stars, 3.0));
    assert_eq!(triggered(&scenario), kinds(&[None, None, None, clouds, clouds, clouds, None]));
}

#[test]
fn clouds_for_an_hour_stay_clouds() {
    let scenario: Vec<FrameFacts> = (0..120).map(|n| facts(if n < 5 { 200 } else { 3 }, 3.0)).collect();
    let raised = triggered(&scenario);
    assert!(raised[..5].iter().all(Vec::is_empty));
    assert!(raised[5..].iter().all(|kinds| *kinds == [TriggerKind::Clouds]));
}

#[test]
fn a_handful_of_stars_is_no_measure() {
    let scenario = [9, 9, 9, 0, 0].map(|stars| facts(stars, 3.0));
    assert!(triggered(&scenario).iter().all(Vec::is_empty));
    let two_before = [100, 100, 0].map(|stars| facts(stars, 3.0));
    assert!(triggered(&two_before).iter().all(Vec::is_empty));
}

#[test]
fn one_blurred_frame_is_seeing_and_five_are_a_drift() {
    let widths = [3.0, 3.1, 2.9, 3.0, 3.1, 6.0, 3.0, 4.2, 4.3, 4.1, 4.2, 4.3];
    let raised = triggered(&widths.map(|width| facts(50, width)));
    let drift = raised.iter().position(|kinds| *kinds == [TriggerKind::FocusDrift]);
    // The 6.0 stays alone and does not count: the median of the last five is above 1.3 x 3.0 px with the third wide
    // one.
    assert_eq!(drift, Some(9), "{raised:?}");
    assert!(raised[9..].iter().all(|kinds| *kinds == [TriggerKind::FocusDrift]));
}

#[test]
fn a_drift_ends_when_the_stars_are_narrow_again() {
    let widths = [vec![3.0; 5], vec![4.0; 5], vec![3.5; 5], vec![3.4; 5]].concat();
    let raised = triggered(&widths.iter().map(|width| facts(50, *width)).collect::<Vec<_>>());
    assert_eq!(raised[9], [TriggerKind::FocusDrift]);
    assert_eq!(raised[14], [TriggerKind::FocusDrift], "3.5 px is still more than 1.15 x 3.0 px");
    assert!(raised[19].is_empty());
}

#[test]
fn what_has_stood_for_long_is_how_it_is_now() {
    let scenario: Vec<FrameFacts> = (0..70).map(|n| facts(50, if n < 5 { 3.0 } else { 4.2 })).collect();
    let raised = triggered(&scenario);
    assert_eq!(raised[60], [TriggerKind::FocusDrift]);
    assert!(raised[69].is_empty(), "the seeing has worsened, and no frame of the last {WINDOW} was better");
}

#[test]
fn two_trailed_frames_trail_and_a_round_one_ends_it() {
    let trailed = FrameFacts { trailed: Some(true), ellipticity: Some(0.5), ..facts(50, 9.0) };
    let round = facts(50, 3.0);
    let scenario = [&round, &trailed, &round, &trailed, &trailed, &trailed, &round].map(Clone::clone);
    let trailing = Some(TriggerKind::Trailing);
    assert_eq!(triggered(&scenario), kinds(&[None, None, None, None, trailing, trailing, None]));
    let mut triggers = Triggers::default();
    scenario.iter().take(6).enumerate().for_each(|(n, facts)| triggers.observe(&light(n), facts));
    assert_eq!(triggers.active(at(5))[0].since_utc, at(3), "since the first of them");
}

#[test]
fn another_field_another_filter_and_a_focus_sweep_are_not_compared() {
    let mut triggers = Triggers::default();
    (0..5).for_each(|n| triggers.observe(&light(n), &facts(100, 3.0)));
    let mut other_filter = light(5);
    other_filter.purpose.filter = Some("B".to_owned());
    triggers.observe(&other_filter, &facts(5, 3.0));
    let mut sweep = light(6);
    sweep.purpose.action = "autofocus".to_owned();
    triggers.observe(&sweep, &facts(0, 20.0));
    let mut longer = light(7);
    longer.exposure_s = 5.0;
    triggers.observe(&longer, &facts(5, 3.0));
    assert_eq!(triggers.active(at(7)), []);
}

#[test]
fn an_older_frame_that_is_measured_late_changes_nothing() {
    let mut triggers = Triggers::default();
    for n in [0, 1, 2, 4] {
        triggers.observe(&light(n), &facts(if n == 4 { 10 } else { 100 }, 3.0));
    }
    triggers.observe(&light(3), &facts(100, 3.0));
    let active = triggers.active(at(4));
    assert_eq!(active.len(), 1);
    assert_eq!((active[0].kind, active[0].since_utc), (TriggerKind::Clouds, at(4)));
    assert_eq!(active[0].detail, "10 stars, the frames before had 100");
}

#[test]
fn a_trigger_without_new_frames_grows_old() {
    let mut triggers = Triggers::default();
    (0..4).for_each(|n| triggers.observe(&light(n), &facts(if n == 3 { 0 } else { 100 }, 3.0)));
    let after = |s: f64| triggers.active(at(3).plus_seconds(s)).len();
    assert_eq!((after(0.0), after(949.0), after(951.0)), (1, 1, 0));
}

#[test]
fn a_frame_that_could_not_be_measured_changes_nothing() {
    let mut triggers = Triggers::default();
    (0..4).for_each(|n| triggers.observe(&light(n), &facts(if n == 3 { 0 } else { 100 }, 3.0)));
    triggers.observe(&light(4), &FrameFacts { reason: Some("not fetched".to_owned()), ..FrameFacts::default() });
    assert_eq!(triggers.active(at(4)).len(), 1);
}

#[test]
fn two_frames_off_target_are_a_wrong_field_until_one_is_on_target() {
    // Frames of 2 x 1 px: half of the shorter side is 0.5 arcmin.
    let off = |arcmin: Option<f64>| FrameFacts {
        off_target_arcmin: arcmin,
        scale_arcsec_px: arcmin.map(|_| 60.0),
        ..facts(50, 3.0)
    };
    let scenario = [0.1, 0.6, 0.4, 0.6, 0.7].map(|arcmin| off(Some(arcmin)));
    let wrong = Some(TriggerKind::WrongField);
    assert_eq!(
        triggered(&scenario),
        kinds(&[None, None, None, None, wrong]),
        "the first one may be about to be corrected"
    );
    let scenario = [Some(9.0), None, Some(9.0), None, Some(0.5), Some(9.0)].map(off);
    assert_eq!(
        triggered(&scenario),
        kinds(&[None, None, wrong, wrong, None, None]),
        "an unsolved frame says nothing of it"
    );
}

#[test]
fn two_frames_with_a_saturated_target_are_a_trigger_until_one_is_not() {
    let target = |saturated| FrameFacts { target_saturated: saturated, ..facts(50, 3.0) };
    let scenario = [Some(true), Some(false), Some(true), None, Some(true), None, Some(false), Some(true)].map(target);
    let too_bright = Some(TriggerKind::TargetSaturated);
    assert_eq!(
        triggered(&scenario),
        kinds(&[None, None, None, None, too_bright, too_bright, None, None]),
        "a frame without a star there says nothing of it"
    );
}

#[test]
fn light_that_is_gone_is_clouds_even_where_stars_are_counted_and_thick_air_is_none() {
    let dim =
        |share: f64, airmass: f64| FrameFacts { transparency: Some(share), airmass: Some(airmass), ..facts(50, 3.0) };
    let clouds = Some(TriggerKind::Clouds);
    let scenario = [dim(0.9, 1.0), dim(0.29, 1.0), dim(0.49, 1.0), dim(0.51, 1.0), dim(0.29, 2.0), dim(0.1, 2.0)];
    assert_eq!(triggered(&scenario), kinds(&[None, clouds, clouds, None, None, clouds]));
    let unknown = FrameFacts { airmass: None, ..dim(0.1, 1.0) };
    assert_eq!(triggered(&[unknown]), kinds(&[None]), "nobody knows how much air there is");
}

#[test]
fn frames_of_nothing_but_cosmic_rays_are_not_the_best_focus() {
    for bad in [0.0, 0.2, 1.1, 1.6] {
        for many in [1, 2, 12] {
            let widths = [vec![3.9; 6], vec![bad; many], vec![3.9; 10]].concat();
            let raised = triggered(&widths.iter().map(|width| facts(50, *width)).collect::<Vec<_>>());
            let drifts = raised.iter().filter(|kinds| !kinds.is_empty()).count();
            // Twelve frames in a row that agree are believed, if a pixel can show it.
            assert!(drifts == 0 || (many > 2 && bad > 1.0), "{many} frames of {bad} px: {raised:?}");
        }
    }
}

#[test]
fn a_focus_that_is_lost_at_once_is_reported_with_the_third_frame() {
    let widths = [vec![3.0; 6], vec![9.0; 5]].concat();
    let raised = triggered(&widths.iter().map(|width| facts(50, *width)).collect::<Vec<_>>());
    assert_eq!(raised.iter().position(|kinds| *kinds == [TriggerKind::FocusDrift]), Some(8), "{raised:?}");
}
