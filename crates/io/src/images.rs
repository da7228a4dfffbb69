//! Where images come from: folders. (The pictures of videos are put into one by whoever reads them.)

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tiepoint_scene::CameraId;

use crate::exif::Exif;
use crate::pixels;
use crate::{Error, Luma, Result, Rgb};

/// Names of files with these endings, in any case, are taken for images.
const IMAGE_EXTENSIONS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];
/// Folders deeper than this below an input are taken for a loop of links.
const MAX_DEPTH: usize = 16;

/// One image of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceImage {
    /// Path relative to the input, with `/`.
    pub name: String,
    /// Which camera took it: an index into [`ImageSource::camera_names`].
    pub camera: CameraId,
}

/// What is known of an image before its pixels are decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageInfo {
    /// Columns, as it is seen (turned by its EXIF orientation).
    pub width: u32,
    /// Rows, as it is seen.
    pub height: u32,
    /// When it was taken, in seconds on its camera's own clock: from its name where that is a time, else from EXIF.
    pub time_s: Option<f64>,
    /// What the camera says.
    pub exif: Exif,
}

/// A list of images by one or more cameras; pixels on demand, from any thread.
pub trait ImageSource: Send + Sync {
    /// All images, in byte order of their names; those of one camera stand together.
    fn images(&self) -> &[SourceImage];
    /// The cameras, in the order of their first images.
    fn camera_names(&self) -> &[String];
    /// Size, time and EXIF data of an image.
    fn info(&self, index: usize) -> Result<ImageInfo>;
    /// The grey image.
    fn luma(&self, index: usize) -> Result<Luma>;
    /// The colour image.
    fn rgb(&self, index: usize) -> Result<Rgb>;
    /// Where to look in the image: nothing is to be detected where the mask is 0. Of the size of the image.
    fn mask(&self, index: usize) -> Result<Option<Luma>>;
}

/// Images in folders.
#[derive(Clone, Debug)]
pub struct ImageFolder {
    images: Vec<SourceImage>,
    paths: Vec<PathBuf>,
    cameras: Vec<String>,
    masks: Vec<Option<PathBuf>>,
}

impl ImageFolder {
    /// Lists the images of `inputs`. A folder of images is one camera; a folder with one sub-folder per camera is a rig. Names
    /// are relative to the input, or, if there are several inputs, begin with the name of the input's folder.
    ///
    /// With `masks`, the mask of `left/1.jpg` is `left/1.jpg.png` in that folder, as in COLMAP, or `left/1.jpg` or `left/1.png`.
    /// Images without a mask are used whole; but there must be a mask for one image at least.
    pub fn open(inputs: &[PathBuf], masks: Option<&Path>) -> Result<Self> {
        // By name: where it is, and the name of its camera. The map sorts in byte order.
        let mut found: BTreeMap<String, (PathBuf, String)> = BTreeMap::new();
        for input in inputs {
            let own_name = || match input.canonicalize().ok().as_deref().and_then(Path::file_name) {
                Some(name) => text(input, name),
                None => Ok(String::new()),
            };
            let prefix = if inputs.len() > 1 { own_name()? + "/" } else { String::new() };
            let mut here = Vec::new();
            list(input, &mut here, 0)?;
            // Folders directly below the input.
            let top = |path: &Path| -> Result<Option<String>> {
                let mut parts = path.strip_prefix(input).unwrap_or(path).components();
                match (parts.next(), parts.next()) {
                    (Some(first), Some(_)) => text(path, first.as_os_str()).map(Some),
                    _ => Ok(None),
                }
            };
            let tops = here.iter().map(|path| top(path)).collect::<Result<Vec<_>>>()?;
            if let (Some(Some(folder)), true) = (tops.iter().find(|top| top.is_some()), tops.contains(&None))
            {
                let what = format!(
                    "holds both images and a folder of images, `{folder}`: put the images of each camera into a folder of its own"
                );
                return Err(Error::content(input, what));
            }
            if here.is_empty() {
                let what = format!("holds no images (files named .{})", IMAGE_EXTENSIONS.join(", ."));
                return Err(Error::content(input, what));
            }
            for (path, top) in here.into_iter().zip(tops) {
                let relative = path.strip_prefix(input).unwrap_or(&path).components();
                let parts = relative.map(|part| text(&path, part.as_os_str())).collect::<Result<Vec<_>>>()?;
                let camera = match top {
                    Some(folder) => prefix.clone() + &folder,
                    None => own_name()?,
                };
                let name = prefix.clone() + &parts.join("/");
                if let Some((other, _)) = found.insert(name.clone(), (path.clone(), camera)) {
                    let what = format!("two inputs have an image {name}: the other is {}", other.display());
                    return Err(Error::content(&path, what));
                }
            }
        }
        let mut this = Self { images: vec![], paths: vec![], cameras: vec![], masks: vec![] };
        for (name, (path, camera)) in found {
            let known = this.cameras.iter().position(|known| *known == camera);
            let camera = CameraId::from_index(known.unwrap_or_else(|| {
                this.cameras.push(camera);
                this.cameras.len() - 1
            }));
            this.masks.push(masks.and_then(|masks| mask_of(masks, &name)));
            this.paths.push(path);
            this.images.push(SourceImage { name, camera });
        }
        match masks {
            Some(masks) if this.masks.iter().all(Option::is_none) => {
                fs::read_dir(masks).map_err(Error::io(masks))?;
                let what = format!("holds no mask: for {0}, `{0}.png` was looked for", this.images[0].name);
                Err(Error::content(masks, what))
            }
            _ => Ok(this),
        }
    }

    /// The file of an image.
    pub fn path(&self, index: usize) -> &Path {
        &self.paths[index]
    }
}

impl ImageSource for ImageFolder {
    fn images(&self) -> &[SourceImage] {
        &self.images
    }

    fn camera_names(&self) -> &[String] {
        &self.cameras
    }

    fn info(&self, index: usize) -> Result<ImageInfo> {
        let path = &self.paths[index];
        let exif = Exif::read(path)?;
        let (width, height) = pixels::dimensions(path, &exif)?;
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        Ok(ImageInfo { width, height, time_s: stem.and_then(time_from_name).or(exif.time_s), exif })
    }

    fn luma(&self, index: usize) -> Result<Luma> {
        Luma::read(&self.paths[index])
    }

    fn rgb(&self, index: usize) -> Result<Rgb> {
        Rgb::read(&self.paths[index])
    }

    fn mask(&self, index: usize) -> Result<Option<Luma>> {
        let Some(path) = &self.masks[index] else { return Ok(None) };
        let mask = Luma::read(path)?;
        let (width, height) = pixels::dimensions(&self.paths[index], &Exif::read(&self.paths[index])?)?;
        if (mask.width, mask.height) != (width, height) {
            let what = format!(
                "the mask has {} × {} pixels, its image {} has {width} × {height}",
                mask.width, mask.height, self.images[index].name
            );
            return Err(Error::content(path, what));
        }
        Ok(Some(mask))
    }
}

/// All images in a folder and below; hidden files and folders are passed over.
fn list(folder: &Path, found: &mut Vec<PathBuf>, depth: usize) -> Result<()> {
    if depth > MAX_DEPTH {
        return Err(Error::content(
            folder,
            format!("lies deeper than {MAX_DEPTH} folders; is there a loop of links?"),
        ));
    }
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if is_hidden {
            continue;
        }
        // Links are followed; one that leads nowhere is an image that cannot be opened, not a folder.
        if path.is_dir() {
            list(&path, found, depth + 1)?;
        } else if is_image(&path) {
            found.push(path);
        }
    }
    Ok(())
}

/// Whether a file is taken for an image, by its name.
pub fn is_image(path: &Path) -> bool {
    has_extension(path, &IMAGE_EXTENSIONS)
}

/// Whether the ending of a file's name is one of these, in any case.
pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|ending| extensions.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

fn text(path: &Path, part: &std::ffi::OsStr) -> Result<String> {
    part.to_str().map(str::to_owned).ok_or_else(|| Error::content(path, "the name is not UTF-8"))
}

fn mask_of(masks: &Path, name: &str) -> Option<PathBuf> {
    let candidates =
        [masks.join(format!("{name}.png")), masks.join(name), masks.join(name).with_extension("png")];
    candidates.into_iter().find(|path| path.is_file())
}

/// The time that a file is named after: nanoseconds (19 digits), microseconds (16) or milliseconds (13) since 1970, or seconds
/// with a fraction (10 digits, a point, digits), as data sets from robots have it.
fn time_from_name(stem: &str) -> Option<f64> {
    let all_digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if let Some((whole, fraction)) = stem.split_once('.') {
        return (whole.len() == 10 && all_digits(whole) && all_digits(fraction))
            .then(|| stem.parse().ok())?;
    }
    let ticks: u64 = stem.parse().ok().filter(|_| all_digits(stem))?;
    let per_second = match stem.len() {
        19 => 1_000_000_000,
        16 => 1_000_000,
        13 => 1_000,
        _ => return None,
    };
    // Whole seconds and the rest apart: 19 digits do not fit an f64.
    Some((ticks / per_second) as f64 + (ticks % per_second) as f64 / per_second as f64)
}

#[cfg(test)]
mod tests {
    use super::time_from_name;

    #[test]
    fn names_that_are_times() {
        assert_eq!(time_from_name("1403636579763555584"), Some(1_403_636_579.763_555_6));
        assert_eq!(time_from_name("1403636579763555"), Some(1_403_636_579.763_555));
        assert_eq!(time_from_name("1305031102.175304"), Some(1_305_031_102.175_304));
        for stem in ["000000", "IMG_1234", "20240229123456", "12345.5", "1305031102.", "+403636579763", ""] {
            assert_eq!(time_from_name(stem), None, "{stem}");
        }
    }
}
