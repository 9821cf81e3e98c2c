//! The Sun of a forecast compared with the almanac's.

use schedule::plan::sky::Sky;
use sky::next_sun_crossing;
use units::{Angle, Utc};

#[test]
fn the_sun_crosses_an_altitude_at_the_time_of_the_almanac() {
    let config = config::parse(super::SITE, std::path::Path::new(".")).unwrap();
    let mut sky = Sky::of(&config.place).unwrap();
    let noon: Utc = "2026-11-20T16:00:00Z".parse().unwrap();
    for deg in [0.0, -12.0, -18.0] {
        let spans = sky.sun_below(deg, noon, noon.plus_seconds(86_400.0)).unwrap();
        let (site, earth) = sky.site();
        let crossing = |rising| next_sun_crossing(&site, &earth, noon, Angle::from_degrees(deg), rising);
        let (dusk, dawn) = (crossing(false).unwrap().unwrap(), crossing(true).unwrap().unwrap());
        assert_eq!(spans.len(), 1);
        assert!(spans[0].0.seconds_since(dusk).abs() < 5.0, "{deg}: {} {dusk}", spans[0].0);
        assert!(spans[0].1.seconds_since(dawn).abs() < 5.0, "{deg}: {} {dawn}", spans[0].1);
    }
    assert_eq!(sky.sun_below(90.0, noon, noon.plus_seconds(60.0)).unwrap().len(), 1, "always below 90 deg");
    assert!(sky.sun_below(-90.0, noon, noon.plus_seconds(60.0)).unwrap().is_empty());
}
