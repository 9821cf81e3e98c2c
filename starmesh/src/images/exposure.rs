//! A frame out of a file, ready to be measured.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use fits::{Header, Image, Part};
use imaging::{Camera, Frame, Measured, Pixels, StarSearch, is_mosaic, measure, measure_mosaic};

/// Which image of a file is meant.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct Chosen {
    /// Take the image of this HDU, counted from 1 (the primary header); without it the first image with pixels.
    #[arg(long, value_parser = hdu)]
    hdu: Option<usize>,
}

fn hdu(word: &str) -> Result<usize, String> {
    word.parse().ok().filter(|number| *number > 0).ok_or_else(|| "expected a number of 1 and more".to_owned())
}

/// A frame and the header of its file.
pub struct Exposure {
    /// The file that it was read from.
    pub file: PathBuf,
    image: Image,
    /// Whether its pixels see different colours.
    pub mosaic: bool,
}

impl Exposure {
    /// Reads an image of a file: the first one, or that of an HDU.
    pub fn open(file: &Path, chosen: Chosen) -> anyhow::Result<Self> {
        let image = fits::read_part(file, chosen.hdu.map_or(Part::First, Part::Hdu))?;
        let mut exposure = Self { file: file.to_owned(), image, mosaic: false };
        exposure.print_choice(chosen);
        exposure.mosaic = states_mosaic(exposure.header()) || is_mosaic(&exposure.frame()?);
        Ok(exposure)
    }

    /// The HDU that it is in, from 1.
    pub fn hdu(&self) -> usize {
        self.image.hdu
    }

    /// Reports the choice where there was one: which of several images, how many planes. On standard error: the answers
    /// on standard output are for programs too.
    fn print_choice(&self, chosen: Chosen) {
        let file = self.file.display();
        if chosen.hdu.is_none() && !self.image.other_hdus.is_empty() {
            let others: Vec<String> = self.image.other_hdus.iter().map(usize::to_string).collect();
            let others = others.join(", ");
            eprintln!(
                "starmesh: {file}: the image of HDU {} is taken; --hdu takes that of HDU {others}",
                self.image.hdu
            );
        }
        if self.image.planes > 1 {
            eprintln!("starmesh: {file}: a colour image; the mean of its {} planes is taken", self.image.planes);
        }
    }

    /// The header of the file.
    pub fn header(&self) -> &Header {
        &self.image.header
    }

    /// Columns, px.
    pub fn width_px(&self) -> usize {
        self.image.width_px
    }

    /// Rows, px.
    pub fn height_px(&self) -> usize {
        self.image.height_px
    }

    /// The pixels.
    pub fn frame(&self) -> anyhow::Result<Frame<'_>> {
        let pixels = match &self.image.pixels {
            fits::Pixels::U16(counts) => Pixels::U16(counts),
            fits::Pixels::F32(floats) => Pixels::F32(floats),
        };
        Ok(Frame::new(self.width_px(), self.height_px(), pixels)?)
    }

    /// The properties of the camera that are known.
    pub fn camera(&self) -> Camera<'static> {
        // Eight bits end at 255; EGAIN is e-/ADU, while GAIN is often a setting of the camera without a unit.
        let max_adu = (self.image.bitpix == 8).then_some(255.0);
        let gain = self.header().number("EGAIN").ok().filter(|gain| *gain > 0.0);
        Camera { max_adu, gain_e_per_adu: gain.map_or(1.0, |gain| gain as f32), ..Camera::default() }
    }

    /// Its stars and its quality; places in px of the frame, also of a colour mosaic.
    pub fn measure(&self) -> anyhow::Result<Measured> {
        let search = StarSearch::default();
        let measured = if self.mosaic {
            measure_mosaic(&self.frame()?, &self.camera(), &search)
        } else {
            measure(&self.frame()?, &self.camera(), &search)
        };
        measured.with_context(|| format!("{} cannot be measured", self.file.display()))
    }
}

/// Whether the header declares a colour mosaic. The pixels decide where the pattern begins: cut and turned frames still
/// have the old keyword. For binned frames the result is false.
fn states_mosaic(header: &Header) -> bool {
    let binned = ["XBINNING", "YBINNING"].iter().any(|keyword| header.number(keyword).is_ok_and(|by| by > 1.0));
    let is_pattern = |word: &str| ["RGGB", "BGGR", "GRBG", "GBRG"].contains(&word.trim().to_ascii_uppercase().as_str());
    !binned && ["BAYERPAT", "COLORTYP", "FILTER"].iter().any(|keyword| header.text(keyword).is_ok_and(is_pattern))
}
