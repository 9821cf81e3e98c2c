//! The observatory node finds where a frame points: by the target, with optics that it learns, also on a part of the
//! sensor; and reports why where it does not.

use bus::Latest;
use contract::observatory::{FrameFacts, OpticsState, TriggerKind, UnsolvedClass};
use contract::{Key, Part};
use imaging::Wcs;
use units::Angle;

use crate::MOST;
use crate::site::Site;
use crate::starfield::{Camera, SCALE_ARCSEC_PX, Shot, wcs};

/// Where the telescope should point; the shipped catalogue has some forty stars to 12.5 mag in the field.
const TARGET: (f64, f64) = (83.0, 22.0);
const GUIDER: &str = "
    [[camera]]
    name = \"guider\"
    server = \"a:1\"
    number = 1
    scale_arcsec_px = 6.0
";

/// A site with a camera that is configured to have pixels of 6 arcsec, 3 % wrong.
async fn site() -> Site {
    let mut site = Site::new(1.0).await;
    site.more = GUIDER;
    site.write_schedule(&[]);
    site
}

fn angle(degrees: f64) -> Angle {
    Angle::from_degrees(degrees)
}

/// Distance of the facts' centre from that of the truth, px.
fn off_px(facts: &FrameFacts, truth: &Wcs, (x, y): (f64, f64)) -> f64 {
    let (ra, dec) = truth.pixel_to_sky(x, y);
    let found = (angle(facts.ra_deg.unwrap()), angle(facts.dec_deg.unwrap()));
    imaging::tangent::separation((ra, dec), found).arcseconds() / SCALE_ARCSEC_PX
}

fn commands(site: &Site) -> bool {
    site.night.get().is_some()
}

async fn optics(site: &Site) -> Latest<OpticsState> {
    site.bus.latest(&Key::Observatory(site.address.clone(), Part::Optics)).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_solved_and_what_they_teach_outlives_a_restart() {
    let site = site().await;
    let optics = optics(&site).await;
    let (camera, node) = (Camera::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    // 3 arcmin from the target, turned by 33 degrees.
    let truth = wcs((TARGET.0 + 0.05, TARGET.1 - 0.01), 33.0, false);
    let first = camera.take(&Shot { target: Some(TARGET), ..Shot::of(truth, 1) }).await;
    println!("first light: {:?} s of {:?} s, {:?} stars", first.solving_s, first.measuring_s, first.matched);
    assert_eq!((first.unsolved.clone(), first.reason.clone()), (None, None));
    let middle = crate::starfield::middle();
    assert!(off_px(&first, &truth, middle) < 0.1, "{first:?}");
    assert!((first.scale_arcsec_px.unwrap() / SCALE_ARCSEC_PX - 1.0).abs() < 5e-4, "{first:?}");
    assert!((first.rotation_deg.unwrap() - 33.0).abs() < 0.02 && first.mirrored == Some(false), "{first:?}");
    assert!(
        first.matched.unwrap() >= 20 && first.rms_px.unwrap() < 0.3 && first.false_alarm.unwrap() < 1e-9,
        "{first:?}"
    );
    let (ra, dec) = truth.pixel_to_sky(middle.0, middle.1);
    let off = imaging::tangent::separation((ra, dec), (angle(TARGET.0), angle(TARGET.1))).degrees() * 60.0;
    assert!((off - 2.85).abs() < 0.05 && (first.off_target_arcmin.unwrap() - off).abs() < 0.02, "{off} {first:?}");
    // The corners, as the published WCS has them.
    let solved = first.wcs.unwrap();
    let solved = Wcs {
        ra: angle(solved.ra_deg),
        dec: angle(solved.dec_deg),
        x_px: solved.x_px,
        y_px: solved.y_px,
        cd_deg_px: solved.cd_deg_px,
        sip: solved.sip.map(|sip| imaging::wcs::Sip { a: sip.a, b: sip.b }),
    };
    for (x, y) in [(0.0, 0.0), (2.0 * middle.0, 0.0), (0.0, 2.0 * middle.1), (2.0 * middle.0, 2.0 * middle.1)] {
        let (ra, dec) = truth.pixel_to_sky(x, y);
        let (at_x, at_y) = solved.sky_to_pixel(ra, dec).unwrap();
        assert!((at_x - x).hypot(at_y - y) < 0.2, "({at_x}, {at_y}) for ({x}, {y})");
    }
    let zero = crate::starfield::ZERO_POINT_MAG;
    assert!((first.zero_point_mag.unwrap() - zero).abs() < 0.03, "{first:?}");
    assert_eq!(first.transparency, None, "nothing to compare it with yet");

    // A frame of half the light, with what the first one taught.
    site.until("optics on the bus", MOST, |_| {
        optics.get().is_some_and(|received| !received.sample.body.optics.is_empty())
    })
    .await;
    let taught = optics.get().unwrap().sample.body;
    assert_eq!((taught.optics[0].camera.as_str(), taught.optics[0].filter.as_deref()), ("guider", Some("V")));
    assert!((taught.zero_points[0].best_mag - zero).abs() < 0.03, "{taught:?}");
    let dim = camera.take(&Shot { target: Some(TARGET), light: 0.5, ..Shot::of(truth, 2) }).await;
    assert!((dim.transparency.unwrap() - 0.5).abs() < 0.03, "{dim:?}");
    node.stop().await;

    // Another incarnation: it knows the optics, so that a corner of the sensor with few stars is enough.
    let node = site.start().await;
    site.until("reported again", MOST, |_| {
        optics.get().is_some_and(|received| !received.sample.body.optics.is_empty())
    })
    .await;
    let part = camera.take(&Shot { target: Some(TARGET), part: [0, 0, 200, 180], ..Shot::of(truth, 3) }).await;
    println!("part: {:?} s, {:?} stars of {:?}", part.solving_s, part.matched, part.stars);
    assert_eq!(part.unsolved, None);
    assert!(off_px(&part, &truth, (99.5, 89.5)) < 0.3, "{part:?}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_field_and_a_turned_camera_are_noticed_by_the_second_frame() {
    let site = site().await;
    let optics = optics(&site).await;
    let (camera, node) = (Camera::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    let wrong = |site: &Site| {
        let triggers = site.night.get().map(|received| received.sample.body.triggers).unwrap_or_default();
        triggers.iter().any(|trigger| trigger.kind == TriggerKind::WrongField && trigger.camera == "guider")
    };
    let shot = |truth, n| Shot { target: Some(TARGET), ..Shot::of(truth, n) };
    let on_target = wcs(TARGET, -50.0, true);
    let facts = camera.take(&shot(on_target, 1)).await;
    assert!(facts.mirrored == Some(true) && facts.off_target_arcmin.unwrap() < 0.02, "{facts:?}");
    let off_target = wcs((TARGET.0 + 0.7, TARGET.1), -50.0, true);
    let facts = camera.take(&shot(off_target, 2)).await;
    assert!((facts.off_target_arcmin.unwrap() - 38.9).abs() < 0.2, "{facts:?}");
    assert!(!wrong(&site), "one frame may be the one before the correction");
    camera.take(&shot(off_target, 3)).await;
    site.until("a wrong field", MOST, wrong).await;
    // Turned by hand, and a mirror less.
    let turned = wcs(TARGET, 120.0, false);
    let facts = camera.take(&shot(turned, 4)).await;
    assert!((facts.rotation_deg.unwrap() - 120.0).abs() < 0.05 && facts.mirrored == Some(false), "{facts:?}");
    site.until("on target again", MOST, |site| !wrong(site)).await;
    let rotation = || optics.get().unwrap().sample.body.optics[0].rotation_deg;
    assert!((rotation() + 50.0).abs() < 0.1, "one frame changes nothing");
    camera.take(&shot(turned, 5)).await;
    site.until("learned anew", MOST, |_| (rotation() - 120.0).abs() < 0.1).await;

    // Stars of no catalogue, and a frame of nowhere.
    let nowhere = camera.take(&Shot { target: Some((TARGET.0, -TARGET.1)), ..Shot::of(turned, 6) }).await;
    println!("nowhere: {:?} s, {:?}", nowhere.solving_s, nowhere.unsolved);
    assert_eq!(nowhere.unsolved.unwrap().class, UnsolvedClass::NoMatch);
    // The bench measures how long that takes: a debug build searches many times slower.
    assert!(nowhere.wcs.is_none() && nowhere.reason.is_none() && nowhere.solving_s.is_some());
    let lost = camera.take(&Shot::of(turned, 7)).await;
    assert_eq!(lost.unsolved.unwrap().class, UnsolvedClass::NoPlace);
    let dark = camera.take(&Shot { image_type: "Dark Frame", ..shot(turned, 8) }).await;
    assert_eq!((dark.wcs, dark.unsolved, dark.solving_s), (None, None, None), "no stars are sought on a dark");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_whose_pixels_are_half_as_large_as_stated_is_understood_by_its_third_frame() {
    let mut site = Site::new(1.0).await;
    // Somebody forgot that it does not bin any more.
    site.more = "[[camera]]\nname = \"guider\"\nserver = \"a:1\"\nnumber = 1\nscale_arcsec_px = 12.3\n";
    site.write_schedule(&[]);
    let optics = optics(&site).await;
    let (camera, node) = (Camera::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    let truth = wcs((TARGET.0 + 0.05, TARGET.1 - 0.01), 33.0, false);
    let shot = |n| Shot { target: Some(TARGET), ..Shot::of(truth, n) };
    for n in 1..=2 {
        let facts = camera.take(&shot(n)).await;
        println!("frame {n}: {:?} s, {:?}", facts.solving_s, facts.unsolved);
        assert!(facts.wcs.is_none() && facts.unsolved.is_some(), "{facts:?}");
    }
    let third = camera.take(&shot(3)).await;
    println!("frame 3: {:?} s, {:?} arcsec/px", third.solving_s, third.scale_arcsec_px);
    assert!(off_px(&third, &truth, crate::starfield::middle()) < 0.1, "{third:?}");
    assert!((third.scale_arcsec_px.unwrap() / SCALE_ARCSEC_PX - 1.0).abs() < 5e-4, "{third:?}");
    // And what it taught holds from then on.
    let learned = |_: &Site| optics.get().is_some_and(|received| !received.sample.body.optics.is_empty());
    site.until("learned", MOST, learned).await;
    let fourth = camera.take(&shot(4)).await;
    println!("frame 4: {:?} s", fourth.solving_s);
    assert!(off_px(&fourth, &truth, crate::starfield::middle()) < 0.1, "{fourth:?}");
    node.stop().await;
}
