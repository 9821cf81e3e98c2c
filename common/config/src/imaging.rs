//! `[imaging]`: what frames are solved with.

use std::path::PathBuf;

use serde::Deserialize;

/// `[imaging]`: what frames are solved with.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Imaging {
    /// Solve each frame that shows stars.
    pub solve: bool,
    /// Star catalogue: Starmesh's own format, a Gaia-2MASS SQLite file, or a FITS or CSV table; the one that is shipped,
    /// to magnitude 11 to 12.5, where absent.
    pub catalogue: Option<PathBuf>,
}

impl Default for Imaging {
    fn default() -> Self {
        Self { solve: true, catalogue: None }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    const HEAD: &str = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
                        elevation_m = 0\n";

    #[test]
    fn frames_are_solved_with_the_shipped_catalogue_unless_configured_otherwise() {
        let config = crate::parse(HEAD, Path::new("/obs")).unwrap();
        assert_eq!(config.imaging, super::Imaging { solve: true, catalogue: None });
        let text = format!("{HEAD}[imaging]\ncatalogue = \"stars/deep.smcat\"\nsolve = false\n");
        let config = crate::parse(&text, Path::new("/obs")).unwrap();
        assert_eq!(config.imaging.catalogue.as_deref(), Some(Path::new("/obs/stars/deep.smcat")));
        assert!(!config.imaging.solve);
        assert!(crate::parse(&format!("{HEAD}[imaging]\ncatalog = \"x\"\n"), Path::new("/obs")).is_err());
    }

    #[test]
    fn a_scale_that_no_camera_has_is_refused() {
        let block =
            |scale: &str| format!("{HEAD}[[camera]]\nname = \"cam\"\nserver = \"a:1\"\nscale_arcsec_px = {scale}\n");
        let config = crate::parse(&block("0.35"), Path::new("/")).unwrap();
        assert_eq!(config.camera[0].scale_arcsec_px, Some(0.35));
        for wrong in ["0.0", "-1.0", "nan", "6000.0"] {
            let error = crate::parse(&block(wrong), Path::new("/")).unwrap_err().to_string();
            assert!(
                error.contains("camera \"cam\": scale_arcsec_px") && error.contains("expected 0.01 to 600"),
                "{error}"
            );
        }
    }
}
