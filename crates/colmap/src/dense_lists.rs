//! The lists of images in a dense workspace: `stereo/patch-match.cfg` and `stereo/fusion.cfg`.

use std::collections::BTreeMap;
use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::io::read_text;

/// Largest list: a million images with 20 sources, with names of 100 characters.
const MAX_BYTES: u64 = 2 << 30;

/// Source images of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Sources {
    /// At most this many images, chosen by common points: `__auto__, 20`, or `__all__`.
    Auto(usize),
    /// These images, the best first.
    Named(Vec<usize>),
}

/// The images that get a depth map, and their sources, as indices of `names`.
///
/// # Errors
///
/// The file cannot be read, or names an image that is not among `names`.
pub(super) fn read_problems(
    path: &Path,
    names: &BTreeMap<&str, usize>,
) -> Result<BTreeMap<usize, Sources>, Error> {
    let text = read_text(path, MAX_BYTES, "list of images")?;
    let mut problems = BTreeMap::new();
    let mut lines = lines(&text);
    while let Some((number, image)) = lines.next() {
        let index = index_of(path, number, image, names)?;
        let Some((number, sources)) = lines.next() else {
            let what = format!(
                "line {number}: {image} has no line of sources behind it: add `__auto__, 20`, or \
                 the names of images with commas between them"
            );
            return Err(Error::Colmap { path: path.to_owned(), what });
        };
        let words: Vec<&str> =
            sources.split([',', ';']).map(str::trim).filter(|word| !word.is_empty()).collect();
        let sources = match words.as_slice() {
            ["__all__"] => Sources::Auto(usize::MAX),
            ["__auto__", count] => Sources::Auto(count.parse().map_err(|_| {
                let what = format!("line {number}: {count} is no number of images");
                Error::Colmap { path: path.to_owned(), what }
            })?),
            named => {
                let of = |name: &&str| index_of(path, number, name, names);
                let named: Vec<usize> = named.iter().map(of).collect::<Result<_, _>>()?;
                Sources::Named(named.into_iter().filter(|source| *source != index).collect())
            }
        };
        problems.insert(index, sources);
    }
    Ok(problems)
}

/// The images whose depth maps are fused, as indices of `names` in ascending order.
///
/// # Errors
///
/// The file cannot be read, or names an image that is not among `names`.
pub(super) fn read_fused(path: &Path, names: &BTreeMap<&str, usize>) -> Result<Vec<usize>, Error> {
    let text = read_text(path, MAX_BYTES, "list of images")?;
    let indices = lines(&text).map(|(number, name)| index_of(path, number, name, names));
    let mut indices: Vec<usize> = indices.collect::<Result<_, _>>()?;
    indices.sort_unstable();
    indices.dedup();
    Ok(indices)
}

/// Lines with their numbers, without empty ones and comments.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = (1..).zip(text.lines().map(str::trim));
    lines.filter(|(_, line)| !(line.is_empty() || line.starts_with('#')))
}

fn index_of(
    path: &Path,
    number: usize,
    name: &str,
    names: &BTreeMap<&str, usize>,
) -> Result<usize, Error> {
    names.get(name).copied().ok_or_else(|| {
        let what = format!(
            "line {number}: {name:?} is no image with a pose in the model beside it: correct the \
             line, or undistort the images again with image_undistorter"
        );
        Error::Colmap { path: path.to_owned(), what }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> BTreeMap<&'static str, usize> {
        BTreeMap::from([("a.jpg", 0), ("left/b c.jpg", 1), ("d.jpg", 2)])
    }

    fn problems(text: &str) -> Result<BTreeMap<usize, Sources>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("patch-match.cfg");
        std::fs::write(&path, text).unwrap();
        read_problems(&path, &names()).map_err(|error| error.to_string())
    }

    #[test]
    fn sources_are_named_or_chosen() {
        let found = problems(
            "# made by hand\n\nd.jpg\n__auto__, 7\r\n  a.jpg \n d.jpg,left/b c.jpg, a.jpg,\n\
             left/b c.jpg\n__all__\n",
        );
        let expected = [
            (0, Sources::Named(vec![2, 1])),
            (1, Sources::Auto(usize::MAX)),
            (2, Sources::Auto(7)),
        ];
        assert_eq!(found, Ok(expected.into()));
        for (text, parts) in [
            ("a.jpg\n", ["line 1", "no line of sources"]),
            ("a.jpg\n__auto__, many\n", ["line 2", "many"]),
            ("\na.jpg\nd.jpg, e.jpg\n", ["line 3", "\"e.jpg\""]),
            ("__auto__, 20\na.jpg\n", ["line 1", "__auto__"]),
        ] {
            let error = problems(text).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
            assert!(error.contains("patch-match.cfg"), "{error}");
        }
    }
}
