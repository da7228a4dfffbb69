/// A file with the name of an image that cannot be used, or a folder of such files.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SkippedFile {
    /// Its name, in the form of the names of images; control characters and bytes that are not
    /// UTF-8 are escaped.
    pub name: String,
    /// The reason: a sentence that begins with the path.
    pub reason: String,
    /// Number of further files beside it that the reason holds for.
    pub others: usize,
}
