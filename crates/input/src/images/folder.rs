//! Sources of images: folders. (The pipeline extracts the frames of videos into a folder.)

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use tiepoint_io::{Error, Result};
use tiepoint_scene::CameraId;
use tiepoint_store::{escaped, irregular_kind, is_inside, manifest_files, require_regular_file};

use super::exif::Exif;
use super::folder_names::{
    MAX_DEPTH, derived_folders, is_mask_folder, is_system_folder, is_thumbnail_folder,
};
use super::masks::Masks;
use super::pixels::{self, SizeLimit, Turn};
use super::skipped::SkippedFile;
use super::{DEFAULT_MAX_PIXELS, Luma, Rgb};

/// File name extensions of images, in any case.
const IMAGE_EXTENSIONS: [&str; 11] =
    ["jpg", "jpeg", "jpe", "jfif", "png", "tif", "tiff", "webp", "bmp", "ppm", "pgm"];
/// File name extensions of videos, in any case.
pub(crate) const VIDEO_EXTENSIONS: [&str; 8] =
    ["mp4", "mov", "m4v", "mkv", "avi", "mts", "m2ts", "webm"];
/// Photos that are not read, because no kept library in Rust decodes them (HEIC, AVIF), or none
/// with a licence like ours (camera raw), or because none encodes them, and an undistorted photo
/// has the format of its photo (JPEG 2000, JPEG XL). They are named.
const UNREAD: [Unread; 7] = [
    Unread {
        extensions: &["heic", "heif", "hif"],
        what: "a HEIC photo",
        remedy: "convert them to JPEG, as with `heif-convert {from} {to}`",
        to: "jpg",
    },
    Unread {
        extensions: &["avif", "avifs"],
        what: "an AVIF photo",
        remedy: "convert them, as with `avifdec {from} {to}`",
        to: "png",
    },
    Unread {
        extensions: &["jp2", "j2k", "j2c", "jpc", "jpf", "jpx", "jpm"],
        what: "a JPEG 2000 photo",
        remedy: "convert them, as with `opj_decompress -i {from} -o {to}`",
        to: "png",
    },
    Unread {
        extensions: &["jxl"],
        what: "a JPEG XL photo",
        remedy: "convert them, as with `djxl {from} {to}`",
        to: "png",
    },
    Unread {
        extensions: &[
            "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "raf", "rw2", "rwl",
            "orf", "pef", "srw", "x3f", "3fr", "fff", "iiq", "erf", "mef", "mos", "mrw", "dcr",
            "kdc", "gpr", "raw",
        ],
        what: "a camera's raw file",
        remedy: "develop them to JPEG or TIFF, as with `darktable-cli {from} {to}`",
        to: "jpg",
    },
    Unread {
        extensions: &["gif", "tga", "exr", "hdr", "psd", "dds", "qoi", "mpo"],
        what: "an image of another format",
        remedy: "convert them, as with `magick {from} {to}`",
        to: "png",
    },
    Unread {
        extensions: &VIDEO_EXTENSIONS,
        what: "a video beside photos",
        remedy: "give videos in a run of their own, or their frames as photos, as with `ffmpeg -i \
                 {from} {to}`",
        to: "%06d.jpg",
    },
];
/// Photos that are named as if they were none, or something else. They are not read, because
/// undistorted photos are written under their names.
const MISNAMED: Unread = Unread {
    extensions: &[],
    what: "a JPEG file by its content but not by its name",
    remedy: "rename them, as {from} to {to}",
    to: "jpg",
};
/// More names of files that are not read are counted, not listed.
const MAX_UNREAD_NAMES: usize = 8;

/// A kind of photos that are not read.
struct Unread {
    extensions: &'static [&'static str],
    what: &'static str,
    /// What to do, with `{from}` and `{to}` for names of files.
    remedy: &'static str,
    /// Extension of the converted file.
    to: &'static str,
}

/// One image of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceImage {
    /// Path relative to the input, with `/`.
    pub name: String,
    /// The camera: an index into [`ImageFolder::camera_names`].
    pub camera: CameraId,
}

/// Metadata of an image: size, time and EXIF data.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageInfo {
    /// Width in pixels, after the rotation that the EXIF orientation asks for.
    pub width: u32,
    /// Height in pixels, after that rotation.
    pub height: u32,
    /// Time in seconds on the clock of the camera: from the file name if that is a time, else from
    /// EXIF.
    pub time_s: Option<f64>,
    /// The EXIF data.
    pub exif: Exif,
}

/// How the mask of a photo that EXIF turns or mirrors is stored.
enum MaskOrientation {
    /// As the photo is stored, to be turned by this orientation.
    Stored(u8),
    /// As the photo is seen.
    Upright,
    /// The sizes do not tell. The orientation of the photo.
    Undecided(u8),
}

/// The images of one or more folders.
#[derive(Clone, Debug)]
pub struct ImageFolder {
    images: Vec<SourceImage>,
    paths: Vec<PathBuf>,
    cameras: Vec<String>,
    masks: Vec<Option<PathBuf>>,
    skipped: Vec<SkippedFile>,
    notes: Vec<String>,
    max_pixels: u64,
    turn: Turn,
    /// Whether masks are stored in the orientation of the stored photo, where sizes do not tell.
    are_masks_stored: bool,
    /// Bits of the values of each camera's images of 16 bits a channel, once one is read. One
    /// number for all, so that the brightness of a camera stays the same.
    bits: Arc<[OnceLock<u32>]>,
}

/// More names in a note are counted, not listed.
const MAX_NOTED_NAMES: usize = 8;

impl ImageFolder {
    /// Lists the images of `inputs`. A folder of images is one camera; a folder with one sub-folder
    /// per camera is a rig. Names are relative to the input. If there are several inputs, names
    /// begin with the name of the folder of the input.
    ///
    /// With `masks`, the mask of `left/1.jpg` is `left/1.jpg.png` in that folder, as in COLMAP, or
    /// `left/1.jpg` or `left/1.png`. Images without a mask are used entirely; at least one image
    /// must have a mask.
    ///
    /// A file with the name of an image is skipped if it is not a regular file, or if a model
    /// cannot hold its name; the same holds for the images below a folder with such a name. Images
    /// that the [`MANIFEST`](tiepoint_store::MANIFEST) of a sub-folder names were written by this
    /// program and are ignored. Images that the manifest of the input itself names are ignored
    /// unless there are no others.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read or holds no images that can be used, if two images have the same
    /// name, and if there is no mask.
    pub fn open(inputs: &[PathBuf], masks: Option<&Path>) -> Result<Self> {
        // By name: the path, and the name of the camera. The map sorts in byte order.
        let mut found: BTreeMap<String, (PathBuf, String)> = BTreeMap::new();
        let (mut skipped, mut set_aside, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        for input in inputs {
            let folder_name = folder_name(input);
            let prefix =
                if inputs.len() > 1 { prefix(input, &folder_name)? } else { String::new() };
            let mut listing = Listing::of_input(input, prefix)?;
            listing.set_aside_derived(input);
            if let Some(folder) = listing.folder_beside_images() {
                let what = format!(
                    "holds both images and a folder of images, `{folder}`: move that folder out of \
                    it, or, if it is of another camera, put the images of each camera into a \
                    folder of their own"
                );
                return Err(Error::content(input, what));
            }
            if listing.images.is_empty() {
                return Err(Error::content(input, listing.no_images_message()));
            }
            for image in listing.images {
                let camera = match image.top_folder() {
                    Some(folder) => listing.prefix.clone() + folder,
                    None => escaped(Path::new(&folder_name)),
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
            set_aside.extend(listing.set_aside);
            notes.extend(listing.notes);
        }
        notes.splice(0..0, set_aside_note(&set_aside));
        let mut this = Self::of_found(found, skipped, masks)?;
        this.notes.splice(0..0, notes);
        Ok(this)
    }

    /// The images by name: the path, and the name of the camera.
    fn of_found(
        found: BTreeMap<String, (PathBuf, String)>,
        skipped: Vec<SkippedFile>,
        masks: Option<&Path>,
    ) -> Result<Self> {
        let mut this = Self {
            images: vec![],
            paths: vec![],
            cameras: vec![],
            masks: vec![],
            skipped,
            notes: vec![],
            max_pixels: DEFAULT_MAX_PIXELS,
            turn: Turn::Upright,
            are_masks_stored: false,
            bits: Arc::new([]),
        };
        let masks_of = masks.map(Masks::open);
        for (name, (path, camera)) in found {
            let known = this.cameras.iter().position(|known| *known == camera);
            let camera = CameraId::from_index(known.unwrap_or_else(|| {
                this.cameras.push(camera);
                this.cameras.len() - 1
            }));
            let mask = masks_of.as_ref().and_then(|masks| masks.of(&name, &mut this.skipped));
            if let Some(mask) = mask.as_ref().filter(|mask| is_same_file(mask, &path)) {
                let what = format!(
                    "is the photo {name} itself and would be its own mask: put masks into a folder \
                    of their own, and give that by `features.masks`"
                );
                return Err(Error::content(mask, what));
            }
            this.masks.push(mask);
            this.paths.push(path);
            this.images.push(SourceImage { name, camera });
        }
        this.bits = this.cameras.iter().map(|_| OnceLock::new()).collect();
        this.skipped.sort();
        this.skipped.dedup();
        match masks {
            Some(masks) if !this.images.is_empty() && this.masks.iter().all(Option::is_none) => {
                fs::read_dir(masks).map_err(Error::io(masks))?;
                let what = format!(
                    "holds no mask: for {0}, `{0}.png` was looked for, or its name with .png, \
                    .mask.png or _mask.png for its extension; each photo needs one of its own",
                    this.images[0].name
                );
                Err(Error::content(masks, what))
            }
            Some(_) => {
                this.note_masks();
                Ok(this)
            }
            None => Ok(this),
        }
    }

    /// Decides how masks are stored, and notes what is unusual about them.
    fn note_masks(&mut self) {
        let without = self.images.iter().zip(&self.masks).filter(|(_, mask)| mask.is_none());
        let without: Vec<&str> = without.map(|(image, _)| image.name.as_str()).collect();
        if !without.is_empty() {
            let (count, all) = (without.len(), self.images.len());
            let names = first_names(&without);
            let note = format!("{count} of {all} photos have no mask and are used whole: {names}");
            self.notes.push(note);
        }
        // Photos that EXIF turns or mirrors whose masks sizes do not tell.
        let mut undecided: Vec<&str> = Vec::new();
        let (mut stored, mut upright) = (0, 0);
        for (index, image) in self.images.iter().enumerate() {
            match self.mask_orientation(index) {
                Some(MaskOrientation::Stored(_)) => stored += 1,
                Some(MaskOrientation::Upright) => upright += 1,
                Some(MaskOrientation::Undecided(_)) => undecided.push(&image.name),
                None => {}
            }
        }
        // One program wrote the masks.
        self.are_masks_stored = stored > 0 && upright == 0;
        let note = if stored > 0 {
            format!(
                "{stored} masks are stored like their photos, without the turn that EXIF asks for, \
                and are turned like them"
            )
        } else if upright == 0 && !undecided.is_empty() {
            let names = first_names(&undecided);
            format!(
                "EXIF turns or mirrors photos whose masks have the same size both ways; the masks \
                are taken as upright: {names}"
            )
        } else {
            return;
        };
        self.notes.push(note);
    }

    /// How the mask of a photo that EXIF turns or mirrors is stored; `None` without one, and if a
    /// file cannot be read.
    fn mask_orientation(&self, index: usize) -> Option<MaskOrientation> {
        let (path, mask) = (&self.paths[index], self.masks[index].as_ref()?);
        let ((width, height), orientation) = pixels::stored(path).ok()?;
        if self.turn == Turn::AsStored || orientation == 1 {
            return None;
        }
        let (of_mask, own) = pixels::stored(mask).ok()?;
        if own != 1 {
            return None;
        }
        let is_told = orientation >= 5 && width != height;
        match of_mask {
            size if is_told && size == (width, height) => {
                Some(MaskOrientation::Stored(orientation))
            }
            size if is_told && size == (height, width) => Some(MaskOrientation::Upright),
            size if size == (width, height) => Some(MaskOrientation::Undecided(orientation)),
            _ => None,
        }
    }

    /// The images of these names below a folder, as a model of another program names them: the
    /// folder may hold other files. A camera is the folder of its images. Masks as for
    /// [`ImageFolder::open`].
    ///
    /// # Errors
    ///
    /// If a name leads out of the folder or to no regular file, and if there is no mask.
    pub fn of_names<'a>(
        folder: &Path,
        names: impl IntoIterator<Item = &'a str>,
        masks: Option<&Path>,
    ) -> Result<Self> {
        let mut found = BTreeMap::new();
        for name in names {
            let path = folder.join(name);
            if !is_inside(name) {
                return Err(Error::content(folder, format!("the name {name:?} leads out of it")));
            }
            require_regular_file(&path)?;
            if !path.is_file() {
                let what = format!("has no photo {name}: give the folder that the names begin in");
                return Err(Error::content(folder, what));
            }
            let camera = name.rsplit_once('/').map_or("", |(camera, _)| camera);
            found.insert(name.to_owned(), (path, camera.to_owned()));
        }
        Self::of_found(found, Vec::new(), masks)
    }

    /// Lists the images in a folder and below as COLMAP does: images may lie beside folders of
    /// images, the images of a folder have a camera, and pixels are taken as they are stored,
    /// whatever the EXIF orientation says. Images without a mask are used entirely.
    ///
    /// # Errors
    ///
    /// If the folder cannot be read.
    pub fn as_stored(input: &Path, masks: Option<&Path>) -> Result<Self> {
        let listing = Listing::of_input(input, String::new())?;
        let found = listing.images.into_iter().map(|image| {
            let folder = image.name.rsplit_once('/').map_or("", |(folder, _)| folder).to_owned();
            (image.name, (image.path, folder))
        });
        let this = Self::of_found(found.collect(), listing.skipped, None)?;
        let mut this = this.with_stored_pixels();
        if let Some(masks) = masks {
            let masks = Masks::open(masks);
            let names = this.images.iter().map(|image| &image.name);
            this.masks = names.map(|name| masks.of(name, &mut this.skipped)).collect();
        }
        this.skipped.sort();
        this.skipped.dedup();
        Ok(this)
    }

    /// Takes pixels in the order of the file, whatever the EXIF orientation says, as COLMAP and
    /// many readers of its models do.
    #[must_use]
    pub fn with_stored_pixels(self) -> Self {
        Self { turn: Turn::AsStored, ..self }
    }

    /// Checks, by its header alone, that an image has `width` × `height` pixels.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has another size.
    pub fn check_size(&self, index: usize, width: u32, height: u32) -> Result<()> {
        let limit = SizeLimit::of_photo(width, height);
        pixels::header_turned(&self.paths[index], &limit, self.turn).map(drop)
    }

    /// Sets one mask for all images.
    #[must_use]
    pub fn with_one_mask(mut self, mask: &Path) -> Self {
        self.masks = vec![Some(mask.to_owned()); self.images.len()];
        self
    }

    /// The colour image if it has `width` × `height` pixels, without a limit of pixels.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has another size.
    pub fn rgb_of_size(&self, index: usize, width: u32, height: u32) -> Result<Rgb> {
        let limit = SizeLimit::of_photo(width, height);
        Rgb::read_ranged(&self.paths[index], &limit, self.turn, || self.bits(index))
    }

    /// Bits that the images of 16 bits a channel of the camera of this image use, all of them. The
    /// first call decodes them, until one uses all 16.
    fn bits(&self, index: usize) -> u32 {
        let camera = self.images[index].camera;
        let of_camera = || {
            let paths = self.images.iter().zip(&self.paths);
            let paths = paths.filter(|(image, _)| image.camera == camera).map(|(_, path)| path);
            let mut most = None;
            for path in paths.filter(|path| pixels::is_deep(path)) {
                // Those that cannot be read are skipped.
                let bits = pixels::bits_of(path, &SizeLimit::Pixels(self.max_pixels)).ok();
                most = most.max(bits);
                if most == Some(pixels::ALL_BITS) {
                    break;
                }
            }
            most.unwrap_or(pixels::ALL_BITS)
        };
        *self.bits[camera.index()].get_or_init(of_camera)
    }

    /// Notes the cameras whose images of 16 bits a channel use fewer, a sentence each: their values
    /// are scaled. Decodes all such images of a camera.
    pub fn notes_on_bits(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for (camera, name) in self.cameras.iter().enumerate() {
            let mut of_camera =
                self.images.iter().zip(&self.paths).enumerate().filter(|(_, (image, path))| {
                    image.camera.index() == camera && pixels::is_deep(path)
                });
            let bits = of_camera.next().map(|(index, _)| self.bits(index));
            if let Some(bits) = bits.filter(|bits| *bits < pixels::ALL_BITS) {
                let name = escaped(Path::new(name));
                notes.push(format!(
                    "{name}: its files of 16 bits a channel use {bits}, and are scaled from these \
                    to 8"
                ));
            }
        }
        notes
    }

    /// Sets the limit of pixels: larger images are refused when they are read
    /// ([`DEFAULT_MAX_PIXELS`] by default).
    #[must_use]
    pub fn with_max_pixels(self, max_pixels: u64) -> Self {
        Self { max_pixels, ..self }
    }

    /// The files that cannot be used, in byte order of their names.
    pub fn skipped(&self) -> &[SkippedFile] {
        &self.skipped
    }

    /// What is unusual about the masks, a sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The file of an image.
    pub fn path(&self, index: usize) -> &Path {
        &self.paths[index]
    }

    /// The file of the mask of an image.
    pub fn mask_path(&self, index: usize) -> Option<&Path> {
        self.masks[index].as_deref()
    }

    /// All images in byte order of their names; the images of a camera are contiguous.
    pub fn images(&self) -> &[SourceImage] {
        &self.images
    }

    /// The cameras in the order of their first images.
    pub fn camera_names(&self) -> &[String] {
        &self.cameras
    }

    /// Size, time and EXIF data of an image.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or is larger than permitted.
    pub fn info(&self, index: usize) -> Result<ImageInfo> {
        let path = &self.paths[index];
        let (exif, width, height) = self.header(path)?;
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        Ok(ImageInfo { width, height, time_s: stem.and_then(time_from_name).or(exif.time_s), exif })
    }

    /// The grey image, upright.
    ///
    /// # Errors
    ///
    /// If the file cannot be decoded, or is larger than permitted.
    pub fn luma(&self, index: usize) -> Result<Luma> {
        let limit = SizeLimit::Pixels(self.max_pixels);
        Luma::read_ranged(&self.paths[index], &limit, self.turn, || self.bits(index))
    }

    /// The colour image, upright.
    ///
    /// # Errors
    ///
    /// If the file cannot be decoded, or is larger than permitted.
    pub fn rgb(&self, index: usize) -> Result<Rgb> {
        let limit = SizeLimit::Pixels(self.max_pixels);
        Rgb::read_ranged(&self.paths[index], &limit, self.turn, || self.bits(index))
    }

    /// The mask of an image, of equal size: no features are detected where it is 0. It is 0, too,
    /// where the image is transparent. `None` without a mask.
    ///
    /// # Errors
    ///
    /// If the mask cannot be decoded, or does not have the size of the image.
    pub fn mask(&self, index: usize) -> Result<Option<Luma>> {
        let limit = SizeLimit::Pixels(self.max_pixels);
        let seen = Luma::read_transparency(&self.paths[index], &limit, self.turn)?;
        let mask = self.with_mask(index, |path, limit, orientation| {
            Luma::read_mask(path, limit, self.turn, orientation)
        })?;
        Ok(match (mask, seen) {
            (Some(mut mask), Some(seen)) => {
                let both = mask.data.iter_mut().zip(seen.data);
                both.for_each(|(value, seen)| *value = (*value).min(seen));
                Some(mask)
            }
            (mask, seen) => mask.or(seen),
        })
    }

    /// Checks, by its header alone, that the mask of an image, if there is one, has its size.
    ///
    /// # Errors
    ///
    /// If a file cannot be read or is not an image, or if the sizes differ.
    pub fn check_mask(&self, index: usize) -> Result<()> {
        self.with_mask(index, |path, limit, orientation| {
            let ((width, height), own) = pixels::stored(path)?;
            let orientation = match self.turn {
                Turn::Upright if own != 1 => own,
                Turn::Upright => orientation,
                Turn::AsStored => 1,
            };
            pixels::turned_size(path, orientation, (width, height), limit)
        })
        .map(drop)
    }

    /// Reads something of the mask of an image, and requires its size. The orientation is that by
    /// which a mask without EXIF data is turned.
    fn with_mask<T>(
        &self,
        index: usize,
        read: impl FnOnce(&Path, &SizeLimit, u8) -> Result<T>,
    ) -> Result<Option<T>> {
        let Some(path) = &self.masks[index] else { return Ok(None) };
        let orientation = match self.mask_orientation(index) {
            Some(MaskOrientation::Stored(orientation)) => orientation,
            Some(MaskOrientation::Undecided(orientation)) if self.are_masks_stored => orientation,
            _ => 1,
        };
        let (_, width, height) = self.header(&self.paths[index])?;
        let of = format!("its image {}", self.images[index].name);
        let limit = SizeLimit::Size { width, height, what: pixels::MASK, of: &of };
        read(path, &limit, orientation).map(Some)
    }

    /// EXIF data, width and height of an image.
    fn header(&self, path: &Path) -> Result<(Exif, u32, u32)> {
        pixels::header_turned(path, &SizeLimit::Pixels(self.max_pixels), self.turn)
    }
}

/// The name of a folder, also for inputs such as `.`; empty if it has none.
fn folder_name(input: &Path) -> OsString {
    let whole = input.canonicalize().ok();
    whole.as_deref().and_then(Path::file_name).map(OsStr::to_owned).unwrap_or_default()
}

/// The prefix of the names of the images of an input, if there are several inputs.
fn prefix(input: &Path, folder_name: &OsStr) -> Result<String> {
    match (invalid_name_reason(folder_name, true, false), folder_name.to_str()) {
        (None, Some(name)) => Ok(name.to_owned() + "/"),
        (reason, _) => {
            let reason = reason.unwrap_or(NOT_UTF8);
            let what = format!(
                "{reason}, and with several inputs it begins the names of images: rename the folder"
            );
            Err(Error::content(input, what))
        }
    }
}

const NOT_UTF8: &str = "its name is not UTF-8";

/// The reason why the name of a file or folder cannot be the first, last or a middle part of the
/// name of an image. Text files of COLMAP and of times hold a name on a line, and trim white space
/// around it.
fn invalid_name_reason(part: &OsStr, is_first: bool, is_last: bool) -> Option<&'static str> {
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

/// An image file.
struct FoundImage {
    path: PathBuf,
    /// Path relative to the input, with `/`.
    name: String,
}

impl FoundImage {
    /// The folder directly below the input that contains the image.
    fn top_folder(&self) -> Option<&str> {
        self.name.split_once('/').map(|(top_folder, _)| top_folder)
    }
}

/// The files of an input.
struct Listing {
    /// Prefix of the names of the images.
    prefix: String,
    images: Vec<FoundImage>,
    skipped: Vec<SkippedFile>,
    /// Images that this program wrote.
    generated: BTreeSet<PathBuf>,
    /// Folders that are no cameras, and the number of images below each.
    set_aside: Vec<(String, usize)>,
    /// What is to be noted.
    notes: Vec<String>,
}

impl Listing {
    fn new(prefix: String) -> Self {
        Self {
            prefix,
            images: vec![],
            skipped: vec![],
            generated: BTreeSet::new(),
            set_aside: vec![],
            notes: vec![],
        }
    }

    fn of_input(input: &Path, prefix: String) -> Result<Self> {
        let mut this = Self::new(prefix);
        require_folder(input)?;
        this.list(input, "", 0)?;
        let own_files = manifest_files(input);
        // A folder with only images of this program is an input by intention.
        if this.images.iter().any(|image| !own_files.contains(&image.path)) {
            this.images.retain(|image| !own_files.contains(&image.path));
        }
        Ok(this)
    }

    /// Adds all images in a folder and below; ignores hidden files and folders. `within` is the
    /// path of the folder relative to the input, with a `/` at its end.
    fn list(&mut self, folder: &Path, within: &str, depth: usize) -> Result<()> {
        if depth > MAX_DEPTH {
            return Err(Error::content(
                folder,
                format!("lies deeper than {MAX_DEPTH} folders; is there a loop of links?"),
            ));
        }
        if depth > 0 {
            self.generated.extend(manifest_files(folder));
        }
        // Names by the index of their kind.
        let mut unread: BTreeMap<usize, Vec<OsString>> = BTreeMap::new();
        let (mut folders, images_before) = (Vec::new(), self.images.len());
        for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
            let path = entry.map_err(Error::io(folder))?.path();
            let Some(part) =
                path.file_name().filter(|part| !part.as_encoded_bytes().starts_with(b"."))
            else {
                continue;
            };
            let is_first = self.prefix.is_empty() && within.is_empty();
            // Links are followed; a broken link is an image that cannot be opened, not a folder.
            let metadata = fs::metadata(&path).ok();
            if metadata.as_ref().is_some_and(fs::Metadata::is_dir) {
                folders.push((part.to_owned(), path));
            } else if let Some(kind) =
                UNREAD.iter().position(|kind| has_extension(&path, kind.extensions))
            {
                let is_file = metadata.as_ref().is_some_and(fs::Metadata::is_file);
                let is_misnamed = is_file && pixels::is_photo_by_content(&path);
                let kind = if is_misnamed { UNREAD.len() } else { kind };
                unread.entry(kind).or_default().push(part.to_owned());
            } else if self.generated.contains(&path) {
                continue;
            } else if !is_named_like_image(&path) {
                let is_file = metadata.as_ref().is_some_and(fs::Metadata::is_file);
                if is_file && pixels::is_photo_by_content(&path) {
                    unread.entry(UNREAD.len()).or_default().push(part.to_owned());
                }
            } else if let Some(kind) = metadata.as_ref().and_then(irregular_kind) {
                self.skip(&path, within, &format!("is {kind} and no regular file"));
            } else {
                match (invalid_name_reason(part, is_first, true), part.to_str()) {
                    (None, Some(part)) => {
                        let name = format!("{within}{part}");
                        self.images.push(FoundImage { path, name });
                    }
                    (reason, _) => {
                        self.skip(
                            &path,
                            within,
                            &format!("{}: rename it", reason.unwrap_or(NOT_UTF8)),
                        );
                    }
                }
            }
        }
        for (kind, parts) in unread {
            self.skip_unread(folder, within, UNREAD.get(kind).unwrap_or(&MISNAMED), parts);
        }
        let has_images = self.images.len() > images_before;
        for (part, path) in folders {
            if is_system_folder(&part) || has_images && is_thumbnail_folder(&part) {
                self.set_aside(&part, &path, within, depth);
            } else {
                self.list_below(&part, &path, within, depth)?;
            }
        }
        Ok(())
    }

    /// Adds the images of a folder in another one.
    fn list_below(&mut self, part: &OsStr, path: &Path, within: &str, depth: usize) -> Result<()> {
        let is_first = self.prefix.is_empty() && within.is_empty();
        match (invalid_name_reason(part, is_first, false), part.to_str()) {
            (None, Some(part)) => self.list(path, &format!("{within}{part}/"), depth + 1)?,
            (reason, _) => {
                let mut below = Self::new(String::new());
                below.list(path, "", depth + 1)?;
                let count = below.images.len() + below.skipped.len();
                if count > 0 {
                    let images = if count == 1 { "image" } else { "images" };
                    let reason = reason.unwrap_or(NOT_UTF8);
                    let what =
                        format!("{reason}, with {count} {images} below it: rename the folder");
                    self.skip(path, within, &what);
                }
            }
        }
        Ok(())
    }

    /// Passes over a folder that is no camera. What is in it need not be readable.
    fn set_aside(&mut self, part: &OsStr, path: &Path, within: &str, depth: usize) {
        let mut below = Self::new(String::new());
        let _ = below.list(path, "", depth + 1);
        let count = below.images.len() + below.set_aside.iter().map(|(_, n)| n).sum::<usize>();
        if count > 0 {
            let part = escaped(Path::new(part));
            self.set_aside.push((format!("{}{within}{part}", self.prefix), count));
        }
    }

    /// Names the files of a folder that are of a kind that is not read, in one sentence. Those with
    /// a converted image beside them are ignored.
    fn skip_unread(
        &mut self,
        folder: &Path,
        within: &str,
        kind: &Unread,
        mut parts: Vec<OsString>,
    ) {
        parts.retain(|part| {
            let beside = |ending: &str| folder.join(part).with_extension(ending).is_file();
            !IMAGE_EXTENSIONS.iter().any(|ending| beside(ending) || beside(&ending.to_uppercase()))
        });
        parts.sort();
        let Some((first, others)) = parts.split_first() else { return };
        let num_others = others.len();
        let shown = |part: &OsString| escaped(Path::new(part));
        let mut named: Vec<String> = others.iter().take(MAX_UNREAD_NAMES).map(shown).collect();
        match others.len() - named.len() {
            0 => {}
            1 => named.push("1 other beside it".to_owned()),
            more => named.push(format!("{more} others beside it")),
        }
        let others = match named.split_last() {
            None => String::new(),
            Some((only, [])) => format!(", as is {only}"),
            Some((last, before)) => format!(", as are {} and {last}", before.join(", ")),
        };
        let to = escaped(&Path::new(first).with_extension(kind.to));
        let remedy = kind.remedy.replace("{from}", &shown(first)).replace("{to}", &to);
        let what = format!("is {}{others}, and these are not read: {remedy}", kind.what);
        self.skip_several(&folder.join(first), within, &what, num_others);
    }

    fn skip(&mut self, path: &Path, within: &str, what: &str) {
        self.skip_several(path, within, what, 0);
    }

    /// Skips a file, and `others` beside it for the same reason.
    fn skip_several(&mut self, path: &Path, within: &str, what: &str, others: usize) {
        let part = path.file_name().map_or_else(String::new, |part| escaped(Path::new(part)));
        let name = format!("{}{within}{part}", self.prefix);
        self.skipped.push(SkippedFile {
            name,
            reason: format!("{}: {what}", escaped(path)),
            others,
        });
    }

    /// Passes over the folders of images that were made from the photos beside them.
    fn set_aside_derived(&mut self, input: &Path) {
        let mut folders: BTreeMap<&str, Vec<(&str, &Path)>> = BTreeMap::new();
        for image in &self.images {
            if let Some((folder, name)) = image.name.split_once('/') {
                folders.entry(folder).or_default().push((name, &image.path));
            }
        }
        let derived = derived_folders(&folders);
        let derived: Vec<(String, String)> =
            derived.into_iter().map(|(a, b)| (a.to_owned(), b.to_owned())).collect();
        for (folder, of) in derived {
            self.images.retain(|image| image.top_folder() != Some(folder.as_str()));
            let path = escaped(&input.join(&folder));
            self.notes.push(format!(
                "{path}: its images are made from those of the same names in `{of}`, and it is no \
                camera: {}",
                if is_mask_folder(&folder) {
                    "give masks by `features.masks`"
                } else {
                    "if it is one, rename the folder"
                }
            ));
        }
    }

    /// A folder of images in an input that also has images of its own.
    fn folder_beside_images(&self) -> Option<&str> {
        let folder = self.images.iter().find_map(FoundImage::top_folder)?;
        self.images.iter().any(|image| image.top_folder().is_none()).then_some(folder)
    }

    /// The message of an input without usable images.
    fn no_images_message(&self) -> String {
        let endings = IMAGE_EXTENSIONS.join(", .");
        match self.skipped.iter().min() {
            None => format!("holds no images (files named .{endings})"),
            Some(SkippedFile { reason, .. }) => {
                let count: usize = self.skipped.iter().map(|file| 1 + file.others).sum();
                format!(
                    "holds no images (files named .{endings}) that can be used; {count} skipped, \
                    first {reason}"
                )
            }
        }
    }
}

/// A note on folders of the system and of thumbnails.
fn set_aside_note(folders: &[(String, usize)]) -> Option<String> {
    let count: usize = folders.iter().map(|(_, count)| count).sum();
    let mut names: Vec<&str> = folders.iter().map(|(name, _)| name.as_str()).collect();
    names.sort_unstable();
    let images = if count == 1 { "1 image is" } else { &format!("{count} images are") };
    (count > 0).then(|| {
        let names = first_names(&names);
        format!("{images} passed over in folders of the system or of thumbnails: {names}")
    })
}

/// Whether two paths lead to one file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    a == b || a.canonicalize().ok().is_some_and(|a| b.canonicalize().ok() == Some(a))
}

/// The first of some names, and the number of the others.
pub(crate) fn first_names(names: &[&str]) -> String {
    let shown: Vec<String> =
        names.iter().take(MAX_NOTED_NAMES).map(|name| escaped(Path::new(name))).collect();
    match names.len() - shown.len() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Whether a file has the name of an image, ignoring white space at its end.
fn is_named_like_image(path: &Path) -> bool {
    is_image(path) || path.to_str().is_some_and(|path| is_image(Path::new(path.trim_end())))
}

/// Whether a file is an image, by its extension.
pub fn is_image(path: &Path) -> bool {
    has_extension(path, &IMAGE_EXTENSIONS)
}

/// Whether a file is a photo or another image of a format that is not read, by its extension.
pub fn is_unread_image(path: &Path) -> bool {
    UNREAD.iter().any(|kind| has_extension(path, kind.extensions))
        && !has_extension(path, &VIDEO_EXTENSIONS)
}

/// Refuses an input that is a file: videos were taken out of the inputs.
fn require_folder(input: &Path) -> Result<()> {
    let Ok(found) = fs::metadata(input) else { return Ok(()) };
    if found.is_dir() {
        return Ok(());
    }
    require_regular_file(input)?;
    let what = if is_image(input) || is_unread_image(input) {
        "is a photo: give the folder that it is in".to_owned()
    } else {
        let videos = VIDEO_EXTENSIONS.join(", ");
        format!(
            "is a file and no video that is read ({videos}): give a folder of photos, or videos"
        )
    };
    Err(Error::content(input, what))
}

/// Whether the extension of a file is one of these, in any case.
pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .is_some_and(|ending| extensions.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// The time in the name of a file, in seconds: nanoseconds (19 digits), microseconds (16) or
/// milliseconds (13) since 1970, or seconds with a fraction (10 digits, a dot, digits). Data sets
/// of robots use these names.
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
    // Whole seconds and the fraction separately: an f64 does not hold 19 digits.
    Some((ticks / per_second) as f64 + (ticks % per_second) as f64 / per_second as f64)
}

#[cfg(test)]
mod tests {
    use super::time_from_name;

    #[test]
    fn times_are_parsed_from_names() {
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
