//! Where images come from: folders. (The pictures of videos are put into one by whoever reads
//! them.)

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

use tiepoint_scene::CameraId;

use crate::exif::Exif;
use crate::manifest::made_files;
use crate::pixels::{self, Allowed};
use crate::regular::{escaped, irregular};
use crate::{Error, Luma, MAX_PIXELS, Result, Rgb};

/// Names of files with these endings, in any case, are taken for images.
const IMAGE_EXTENSIONS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];
/// Files with these endings are photos of telephones, which no well-tried library in Rust reads.
const HEIF_EXTENSIONS: [&str; 3] = ["heic", "heif", "hif"];
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
    /// When it was taken, in seconds on its camera's own clock: from its name where that is a time,
    /// else from EXIF.
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
    /// Where to look in the image: nothing is to be detected where the mask is 0. Of the size of
    /// the image.
    fn mask(&self, index: usize) -> Result<Option<Luma>>;
}

/// A file that would be an image and cannot be used as one, or a folder of such.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SkippedFile {
    /// Its name as an image's would be, with escapes for control characters and for what is no
    /// UTF-8.
    pub name: String,
    /// Why, as a sentence that begins with its path.
    pub why: String,
}

/// Images in folders.
#[derive(Clone, Debug)]
pub struct ImageFolder {
    images: Vec<SourceImage>,
    paths: Vec<PathBuf>,
    cameras: Vec<String>,
    masks: Vec<Option<PathBuf>>,
    skipped: Vec<SkippedFile>,
    max_pixels: u64,
}

impl ImageFolder {
    /// Lists the images of `inputs`. A folder of images is one camera; a folder with one sub-folder
    /// per camera is a rig. Names are relative to the input, or, if there are several inputs, begin
    /// with the name of the input's folder.
    ///
    /// With `masks`, the mask of `left/1.jpg` is `left/1.jpg.png` in that folder, as in COLMAP, or
    /// `left/1.jpg` or `left/1.png`. Images without a mask are used whole; but there must be a mask
    /// for one image at least.
    ///
    /// A file that is named like an image but is no regular file, or whose name a model cannot
    /// hold, is skipped; so are the images below a folder of such a name. Images that a
    /// sub-folder's [`MANIFEST`](crate::MANIFEST) names were made by this program and are passed
    /// over; those that an input's own manifest names are, unless there are no others.
    ///
    /// # Errors
    ///
    /// A folder cannot be read or holds no images that can be used, two images have one name, or
    /// there is no mask.
    pub fn open(inputs: &[PathBuf], masks: Option<&Path>) -> Result<Self> {
        // By name: where it is, and the name of its camera. The map sorts in byte order.
        let mut found: BTreeMap<String, (PathBuf, String)> = BTreeMap::new();
        let mut skipped = Vec::new();
        for input in inputs {
            let own_name = own_name(input);
            let prefix = if inputs.len() > 1 { prefix(input, &own_name)? } else { String::new() };
            let listing = Listing::of_input(input, prefix)?;
            if let Some(folder) = listing.folder_beside_images() {
                let what = format!(
                    "holds both images and a folder of images, `{folder}`: put the images of each \
                    camera into a folder of its own"
                );
                return Err(Error::content(input, what));
            }
            if listing.images.is_empty() {
                return Err(Error::content(input, listing.holds_none()));
            }
            for image in listing.images {
                let camera = match image.top() {
                    Some(folder) => listing.prefix.clone() + folder,
                    None => escaped(Path::new(&own_name)),
                };
                let name = listing.prefix.clone() + &image.name;
                if let Some((other, _)) = found.insert(name.clone(), (image.path.clone(), camera)) {
                    let what = format!(
                        "two inputs have an image {name}: the other is {}",
                        other.display()
                    );
                    return Err(Error::content(&image.path, what));
                }
            }
            skipped.extend(listing.skipped);
        }
        let mut this = Self {
            images: vec![],
            paths: vec![],
            cameras: vec![],
            masks: vec![],
            skipped,
            max_pixels: MAX_PIXELS,
        };
        for (name, (path, camera)) in found {
            let known = this.cameras.iter().position(|known| *known == camera);
            let camera = CameraId::from_index(known.unwrap_or_else(|| {
                this.cameras.push(camera);
                this.cameras.len() - 1
            }));
            this.masks.push(masks.and_then(|masks| mask_of(masks, &name, &mut this.skipped)));
            this.paths.push(path);
            this.images.push(SourceImage { name, camera });
        }
        this.skipped.sort();
        this.skipped.dedup();
        match masks {
            Some(masks) if this.masks.iter().all(Option::is_none) => {
                fs::read_dir(masks).map_err(Error::io(masks))?;
                let what = format!(
                    "holds no mask: for {0}, `{0}.png` was looked for",
                    this.images[0].name
                );
                Err(Error::content(masks, what))
            }
            _ => Ok(this),
        }
    }

    /// The same images; those of more than `max_pixels` are refused when they are looked at
    /// ([`MAX_PIXELS`] by default).
    #[must_use]
    pub fn with_max_pixels(self, max_pixels: u64) -> Self {
        Self { max_pixels, ..self }
    }

    /// What is there and cannot be used, in byte order of the names.
    pub fn skipped(&self) -> &[SkippedFile] {
        &self.skipped
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
        let (exif, width, height) = self.header(path)?;
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        Ok(ImageInfo { width, height, time_s: stem.and_then(time_from_name).or(exif.time_s), exif })
    }

    fn luma(&self, index: usize) -> Result<Luma> {
        Luma::read_within(&self.paths[index], &Allowed::Pixels(self.max_pixels))
    }

    fn rgb(&self, index: usize) -> Result<Rgb> {
        Rgb::read_within(&self.paths[index], &Allowed::Pixels(self.max_pixels))
    }

    fn mask(&self, index: usize) -> Result<Option<Luma>> {
        let Some(path) = &self.masks[index] else { return Ok(None) };
        let (_, width, height) = self.header(&self.paths[index])?;
        let of = format!("its image {}", self.images[index].name);
        Luma::read_within(path, &Allowed::Size { width, height, what: "the mask", of: &of })
            .map(Some)
    }
}

impl ImageFolder {
    /// What an image says of itself: EXIF data, width and height.
    fn header(&self, path: &Path) -> Result<(Exif, u32, u32)> {
        // Before the EXIF data, since those of a TIFF file may be anywhere in it.
        let stored = pixels::stored_size(path)?;
        let exif = Exif::read(path)?;
        let (width, height) =
            pixels::dimensions(path, &exif, stored, &Allowed::Pixels(self.max_pixels))?;
        Ok((exif, width, height))
    }
}

/// The name of a folder itself, whatever it was given as; empty where it has none.
fn own_name(input: &Path) -> OsString {
    let whole = input.canonicalize().ok();
    whole.as_deref().and_then(Path::file_name).map(OsStr::to_owned).unwrap_or_default()
}

/// What the names of an input's images begin with.
fn prefix(input: &Path, own_name: &OsStr) -> Result<String> {
    match (unfit(own_name, true, false), own_name.to_str()) {
        (None, Some(name)) => Ok(name.to_owned() + "/"),
        (why, _) => {
            let why = why.unwrap_or(NOT_UTF8);
            let what = format!(
                "{why}, and with several inputs it begins the names of images: rename the folder"
            );
            Err(Error::content(input, what))
        }
    }
}

const NOT_UTF8: &str = "its name is not UTF-8";

/// Why a file or folder of this name cannot be a part of the name of an image: the first, the last,
/// or one between. COLMAP's text files and lists of times hold a name on a line, and white space
/// around it does not count there.
fn unfit(part: &OsStr, is_first: bool, is_last: bool) -> Option<&'static str> {
    let Some(text) = part.to_str() else { return Some(NOT_UTF8) };
    if text.contains(char::is_control) {
        Some("its name has control characters")
    } else if is_first && text.starts_with(char::is_whitespace) {
        Some("its name begins with white space")
    } else if is_last && text.ends_with(char::is_whitespace) {
        Some("its name ends with white space")
    } else {
        None
    }
}

/// An image that was found.
struct Listed {
    path: PathBuf,
    /// Relative to the input, with `/`.
    name: String,
}

impl Listed {
    /// The folder directly below the input in which it lies.
    fn top(&self) -> Option<&str> {
        self.name.split_once('/').map(|(top, _)| top)
    }
}

/// What lies in an input.
struct Listing {
    /// What the names of images begin with.
    prefix: String,
    images: Vec<Listed>,
    skipped: Vec<SkippedFile>,
    /// Images that this program has made.
    made: BTreeSet<PathBuf>,
}

impl Listing {
    fn new(prefix: String) -> Self {
        Self { prefix, images: vec![], skipped: vec![], made: BTreeSet::new() }
    }

    fn of_input(input: &Path, prefix: String) -> Result<Self> {
        let mut this = Self::new(prefix);
        this.list(input, "", 0)?;
        let own = made_files(input);
        // A folder of nothing but images that this program made is given for those.
        if this.images.iter().any(|image| !own.contains(&image.path)) {
            this.images.retain(|image| !own.contains(&image.path));
        }
        Ok(this)
    }

    /// Adds all images in a folder and below; hidden files and folders are passed over. `within` is
    /// the folder's name relative to the input, with a `/` behind it.
    fn list(&mut self, folder: &Path, within: &str, depth: usize) -> Result<()> {
        if depth > MAX_DEPTH {
            return Err(Error::content(
                folder,
                format!("lies deeper than {MAX_DEPTH} folders; is there a loop of links?"),
            ));
        }
        if depth > 0 {
            self.made.extend(made_files(folder));
        }
        let mut heif = Vec::new();
        for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
            let path = entry.map_err(Error::io(folder))?.path();
            let Some(part) =
                path.file_name().filter(|part| !part.as_encoded_bytes().starts_with(b"."))
            else {
                continue;
            };
            let is_first = self.prefix.is_empty() && within.is_empty();
            // Links are followed; one that leads nowhere is an image that cannot be opened, not a
            // folder.
            let metadata = fs::metadata(&path).ok();
            if metadata.as_ref().is_some_and(fs::Metadata::is_dir) {
                match (unfit(part, is_first, false), part.to_str()) {
                    (None, Some(part)) => {
                        self.list(&path, &format!("{within}{part}/"), depth + 1)?
                    }
                    (why, _) => {
                        let mut below = Self::new(String::new());
                        below.list(&path, "", depth + 1)?;
                        let count = below.images.len() + below.skipped.len();
                        if count > 0 {
                            let images = if count == 1 { "image" } else { "images" };
                            let why = why.unwrap_or(NOT_UTF8);
                            let what =
                                format!("{why}, with {count} {images} below it: rename the folder");
                            self.skip(&path, within, &what);
                        }
                    }
                }
            } else if has_extension(&path, &HEIF_EXTENSIONS) {
                heif.push(part.to_owned());
            } else if !is_named_like_image(&path) || self.made.contains(&path) {
                continue;
            } else if let Some(kind) = metadata.as_ref().and_then(irregular) {
                self.skip(&path, within, &format!("is {kind} and no regular file"));
            } else {
                match (unfit(part, is_first, true), part.to_str()) {
                    (None, Some(part)) => {
                        let name = format!("{within}{part}");
                        self.images.push(Listed { path, name });
                    }
                    (why, _) => {
                        self.skip(
                            &path,
                            within,
                            &format!("{}: rename it", why.unwrap_or(NOT_UTF8)),
                        );
                    }
                }
            }
        }
        // Those that have been converted lie beside.
        heif.retain(|part: &OsString| {
            let beside = |ending: &str| folder.join(part).with_extension(ending).is_file();
            !IMAGE_EXTENSIONS.iter().any(|ending| beside(ending) || beside(&ending.to_uppercase()))
        });
        if let Some(first) = heif.iter().min() {
            let others = match heif.len() - 1 {
                0 => String::new(),
                1 => ", as is 1 other file beside it".to_owned(),
                more => format!(", as are {more} other files beside it"),
            };
            let (from, to) =
                (escaped(Path::new(first)), escaped(&Path::new(first).with_extension("jpg")));
            let what = format!(
                "is a HEIC photo{others}, and these are not read: convert them to JPEG, as with \
                `heif-convert {from} {to}`"
            );
            self.skip(&folder.join(first), within, &what);
        }
        Ok(())
    }

    fn skip(&mut self, path: &Path, within: &str, what: &str) {
        let part = path.file_name().map_or_else(String::new, |part| escaped(Path::new(part)));
        let name = format!("{}{within}{part}", self.prefix);
        self.skipped.push(SkippedFile { name, why: format!("{}: {what}", escaped(path)) });
    }

    /// A folder of images, where there are images beside it.
    fn folder_beside_images(&self) -> Option<&str> {
        let folder = self.images.iter().find_map(Listed::top)?;
        self.images.iter().any(|image| image.top().is_none()).then_some(folder)
    }

    /// That no image can be used.
    fn holds_none(&self) -> String {
        let endings = IMAGE_EXTENSIONS.join(", .");
        match self.skipped.iter().min() {
            None => format!("holds no images (files named .{endings})"),
            Some(SkippedFile { why, .. }) => {
                let count = self.skipped.len();
                format!(
                    "holds no images (files named .{endings}) that can be used; {count} skipped, \
                    first {why}"
                )
            }
        }
    }
}

/// Whether a file would be taken for an image, were there no white space behind its name.
fn is_named_like_image(path: &Path) -> bool {
    is_image(path) || path.to_str().is_some_and(|path| is_image(Path::new(path.trim_end())))
}

/// Whether a file is taken for an image, by its name.
pub fn is_image(path: &Path) -> bool {
    has_extension(path, &IMAGE_EXTENSIONS)
}

/// Whether the ending of a file's name is one of these, in any case.
pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .is_some_and(|ending| extensions.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// The mask of an image. What has its name and is no regular file is skipped.
fn mask_of(masks: &Path, name: &str, skipped: &mut Vec<SkippedFile>) -> Option<PathBuf> {
    let candidates = [
        masks.join(format!("{name}.png")),
        masks.join(name),
        masks.join(name).with_extension("png"),
    ];
    candidates.into_iter().find(|path| {
        let Ok(metadata) = fs::metadata(path) else { return false };
        if let (Some(kind), false) = (irregular(&metadata), metadata.is_dir()) {
            let shown = escaped(path);
            let why = format!("{shown}: is {kind} and no regular file, so it masks nothing");
            skipped.push(SkippedFile { name: shown, why });
        }
        metadata.is_file()
    })
}

/// The time that a file is named after: nanoseconds (19 digits), microseconds (16) or milliseconds
/// (13) since 1970, or seconds with a fraction (10 digits, a point, digits), as data sets from
/// robots have it.
fn time_from_name(stem: &str) -> Option<f64> {
    let all_digits =
        |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
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
        for stem in
            ["000000", "IMG_1234", "20240229123456", "12345.5", "1305031102.", "+403636579763", ""]
        {
            assert_eq!(time_from_name(stem), None, "{stem}");
        }
    }
}
