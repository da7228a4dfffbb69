//! Shards: parts of a stage that are processes of their own, on one machine or on many with a
//! shared folder.
//!
//! Each writes one tile into a hidden folder of the workspace, and nothing else. The stage itself,
//! without a shard, takes the tiles of all shards into the database and removes them when it is
//! complete. Until then the tiles are the result. A stage that keeps parts of its own work as tiles
//! owns these, and discards those that it cannot use.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tiepoint_io::Result as IoResult;
use tiepoint_io::database::{TileReader, TileWriter};
use tiepoint_store::Error as StoreError;
use tiepoint_store::disk::{Folder, temporary_path};

use crate::shard::Shard;
use crate::workspace::folder::Workspace;
use crate::workspace::records::Recipe;
use crate::{Error, Stage};

/// What the content of tiles means, and by which computation it came about. A change that gives
/// features, matches or states of sub-maps other bytes, or another meaning, within one version of
/// the program raises it: tiles of both would give a result that no run has.
const FORMAT: u32 = 3;
/// Folder of the tiles.
pub(crate) const TILES: &str = ".tiepoint-tiles";

/// The tile of a shard.
fn tile_name(stage: Stage, shard: Shard) -> String {
    format!("{TILES}/{stage}-{}-of-{}", shard.number, shard.count)
}

/// The shard that a file in the folder of the tiles has by its name.
fn shard_of(name: &str, stage: Stage) -> Option<Shard> {
    let numbers = name.strip_prefix(stage.name())?.strip_prefix('-')?;
    let shard = numbers.replacen("-of-", "/", 1).parse().ok()?;
    // No other way to write its numbers.
    (tile_name(stage, shard).strip_prefix(TILES)?.strip_prefix('/')? == name).then_some(shard)
}

/// The name of a file in the folder of the tiles, if it is what a killed shard had begun.
fn begun_name(name: &str, stage: Stage) -> Option<String> {
    let shard = shard_of(name.strip_prefix('.')?.split('.').next()?, stage)?;
    let path = temporary_path(Path::new(&tile_name(stage, shard)));
    (path.file_name()? == name).then(|| format!("{TILES}/{name}"))
}

/// What a process that ran a shard says of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShardReport {
    /// The stage.
    pub stage: Stage,
    /// As `2/8`.
    pub shard: String,
    /// The path of the tile; `None` if the stage is complete without it.
    pub tile: Option<String>,
    /// Whether an earlier run did the work.
    pub is_kept: bool,
}

/// The text at the begin of a tile.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Label {
    /// The version of the program.
    version: String,
    /// [`FORMAT`]; builds before it had none.
    #[serde(default)]
    format: u32,
    stage: Stage,
    shard: String,
    /// Whether the stage made it for itself, to go on after a kill, and no process for the shard.
    #[serde(default)]
    is_own: bool,
    recipe: Recipe,
}

impl Label {
    fn new(stage: Stage, shard: Shard, recipe: &Recipe) -> Self {
        let (version, shard) = (env!("CARGO_PKG_VERSION").to_owned(), shard.to_string());
        Self { version, format: FORMAT, stage, shard, is_own: false, recipe: recipe.clone() }
    }

    /// Why a tile with this label is not the one with another; `None` if it is.
    fn why_not(&self, asked: &Self) -> Option<String> {
        if self.version != asked.version {
            return Some(format!("was made by version {}", self.version));
        }
        if self.format != asked.format {
            let formats = format!("tiles of format {} and not {}", self.format, asked.format);
            return Some(format!("was made by another build of this version, with {formats}"));
        }
        if (self.stage, &self.shard) != (asked.stage, &asked.shard) {
            return Some(format!("is a copy of shard {} of {}", self.shard, self.stage));
        }
        let difference = self.recipe.difference(&asked.recipe, self.stage);
        // What was found of the cameras follows from the photos.
        let is_other = self.recipe != asked.recipe;
        let how = difference.or_else(|| is_other.then(|| "from other photos".to_owned()))?;
        Some(format!("was made {how}"))
    }
}

/// The tiles of all shards of a stage, which were complete and of its recipe.
pub(crate) struct CheckedTiles {
    stage: Stage,
    recipe: Recipe,
    shards: Vec<Shard>,
}

/// What there is of a shard.
pub(crate) enum ShardWork {
    /// Nothing is left to do.
    Kept(ShardReport),
    /// The tile that is to be written, and what is said of it then.
    Begin(Box<TileWriter>, ShardReport),
}

impl Workspace {
    /// Begins the tile of a shard, unless an earlier run completed the shard or the whole stage.
    ///
    /// # Errors
    ///
    /// The stage was run with another recipe; an existing tile is damaged or of another recipe, and
    /// `redo` does not name the stage; the tile cannot be written.
    pub(crate) fn begin_shard(
        &self,
        stage: Stage,
        shard: Shard,
        recipe: &Recipe,
        redo: Option<Stage>,
    ) -> Result<ShardWork, Error> {
        let is_redone = redo == Some(stage);
        let name = tile_name(stage, shard);
        let tile = Some(self.root().join(&name).display().to_string());
        let report = ShardReport { stage, shard: shard.to_string(), tile, is_kept: false };
        let kept = |tile| ShardWork::Kept(ShardReport { tile, is_kept: true, ..report.clone() });
        if !is_redone && self.records.is_kept(self.root(), stage, recipe)? {
            return Ok(kept(None));
        }
        if !is_redone && self.tile_of(stage, shard, recipe)?.is_some() {
            return Ok(kept(report.tile.clone()));
        }
        let tile = self.new_tile(stage, shard, &Label::new(stage, shard, recipe))?;
        Ok(ShardWork::Begin(Box::new(tile), report))
    }

    /// Begins the tile of a shard that the stage makes for itself, in place of one that there is.
    ///
    /// # Errors
    ///
    /// It cannot be written.
    pub(crate) fn own_tile(
        &self,
        stage: Stage,
        shard: Shard,
        recipe: &Recipe,
    ) -> Result<TileWriter, Error> {
        let label = Label { is_own: true, ..Label::new(stage, shard, recipe) };
        self.new_tile(stage, shard, &label)
    }

    fn new_tile(&self, stage: Stage, shard: Shard, label: &Label) -> Result<TileWriter, Error> {
        let folder = self.folder.folder();
        folder.create_folders(TILES).map_err(StoreError::output(&folder.join(TILES)))?;
        let text = serde_json::to_vec(label).expect("texts have a JSON form");
        Ok(TileWriter::create(folder, &tile_name(stage, shard), &text)?)
    }

    /// The tile of a shard; `None` if there is none, or one of another recipe that the stage made
    /// for itself.
    ///
    /// # Errors
    ///
    /// It cannot be read, is damaged, or a process for the shard made it of another recipe.
    pub(crate) fn tile_of(
        &self,
        stage: Stage,
        shard: Shard,
        recipe: &Recipe,
    ) -> Result<Option<TileReader>, Error> {
        if !self.folder.folder().has(tile_name(stage, shard)) {
            return Ok(None);
        }
        let (found, label) = self.labelled(stage, shard, TileReader::open)?;
        match label.why_not(&Label::new(stage, shard, recipe)) {
            Some(_) if label.is_own => Ok(None),
            Some(why) => Err(self.wrong(stage, shard, why)),
            None => Ok(Some(found)),
        }
    }

    /// Opens the tile of a shard.
    ///
    /// # Errors
    ///
    /// Those of [`Workspace::labelled`]; it has another label.
    fn tile(
        &self,
        stage: Stage,
        shard: Shard,
        recipe: &Recipe,
        open: impl FnOnce(&Folder, &str) -> IoResult<Option<TileReader>>,
    ) -> Result<TileReader, Error> {
        let (found, label) = self.labelled(stage, shard, open)?;
        match label.why_not(&Label::new(stage, shard, recipe)) {
            Some(why) => Err(self.wrong(stage, shard, why)),
            None => Ok(found),
        }
    }

    /// Opens the tile of a shard, with its label.
    ///
    /// # Errors
    ///
    /// It cannot be read, or is damaged as far as `open` looks.
    fn labelled(
        &self,
        stage: Stage,
        shard: Shard,
        open: impl FnOnce(&Folder, &str) -> IoResult<Option<TileReader>>,
    ) -> Result<(TileReader, Label), Error> {
        let damaged = || self.wrong(stage, shard, "is damaged".to_owned());
        let found = open(self.folder.folder(), &tile_name(stage, shard))?.ok_or_else(damaged)?;
        let label = serde_json::from_slice(found.text()).map_err(|_| damaged())?;
        Ok((found, label))
    }

    fn wrong(&self, stage: Stage, shard: Shard, why: String) -> Error {
        Error::Tile { path: self.folder.folder().join(tile_name(stage, shard)), stage, shard, why }
    }

    /// What there is in the folder of the tiles.
    fn in_tiles<T: Ord>(&self, of: impl Fn(&str) -> Option<T>) -> BTreeSet<T> {
        let entries = fs::read_dir(self.root().join(TILES)).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        names.filter_map(|name| of(&name)).collect()
    }

    /// The shards of a stage that have tiles.
    pub(crate) fn with_tiles(&self, stage: Stage) -> BTreeSet<Shard> {
        self.in_tiles(|name| shard_of(name, stage))
    }

    /// The shards of a stage that have tiles: none, or all that there are.
    ///
    /// # Errors
    ///
    /// Some shards have none, or there are tiles of different numbers of shards.
    fn shards(&self, stage: Stage) -> Result<Vec<Shard>, Error> {
        let path = self.root().join(TILES);
        let found = self.with_tiles(stage);
        let counts: BTreeMap<usize, usize> =
            found.iter().fold(BTreeMap::new(), |mut counts, shard| {
                *counts.entry(shard.count).or_default() += 1;
                counts
            });
        let mut counts = counts.into_iter();
        let Some((count, there)) = counts.next() else { return Ok(Vec::new()) };
        if let Some((other, _)) = counts.next() {
            return Err(Error::TwoDivisions { path, stage, counts: [count, other] });
        }
        if there < count {
            let mut all = Shard::all(count);
            let first = all.find(|shard| !found.contains(shard));
            let shard = first.expect("fewer are there than there are");
            return Err(Error::MissingShard { path, shard, stage, there });
        }
        Ok(found.into_iter().collect())
    }

    /// The sentence that the first of a number of shards without a tile is missing, if one is.
    ///
    /// # Errors
    ///
    /// That it is missing.
    pub(crate) fn require_all<T>(&self, stage: Stage, tiles: &[Option<T>]) -> Result<(), Error> {
        let there = tiles.iter().flatten().count();
        let mut missing = Shard::all(tiles.len()).zip(tiles).filter(|(_, tile)| tile.is_none());
        let path = self.root().join(TILES);
        missing
            .next()
            .map_or(Ok(()), |(shard, _)| Err(Error::MissingShard { path, stage, shard, there }))
    }

    /// Checks the tiles of all shards of a stage; there may be none at all.
    ///
    /// # Errors
    ///
    /// A shard is missing, damaged or of another recipe.
    pub(crate) fn check_tiles(&self, stage: Stage, recipe: &Recipe) -> Result<CheckedTiles, Error> {
        let shards = self.shards(stage)?;
        for shard in &shards {
            self.tile(stage, *shard, recipe, TileReader::open)?;
        }
        Ok(CheckedTiles { stage, recipe: recipe.clone(), shards })
    }

    /// Takes tiles that were checked, one after the other. Their content is not hashed again: who
    /// takes them holds the workspace alone since then.
    ///
    /// # Errors
    ///
    /// Those of `take`; a tile is gone, or another one.
    pub(crate) fn for_each_tile(
        &self,
        CheckedTiles { stage, recipe, shards }: &CheckedTiles,
        mut take: impl FnMut(TileReader) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let open = TileReader::open_unchecked;
        shards.iter().try_for_each(|shard| take(self.tile(*stage, *shard, recipe, open)?))
    }

    /// Removes the tiles of a recipe of a stage that is complete and those that it made for itself,
    /// and their folder if it is empty then. Returns a sentence on those that stay: ones without a
    /// readable begin, and those of other recipes, which wait for a run with `redo`. Of all of them
    /// the begin alone is read.
    ///
    /// # Errors
    ///
    /// They cannot be read or removed.
    pub(crate) fn remove_tiles_of(
        &self,
        stage: Stage,
        recipe: &Recipe,
    ) -> Result<Option<String>, Error> {
        let (mut own, mut others) = (BTreeSet::new(), Vec::new());
        for shard in self.with_tiles(stage) {
            let why = match self.labelled(stage, shard, TileReader::open_unchecked) {
                Ok((_, label)) if label.is_own => None,
                Ok((_, label)) => {
                    label.recipe.difference(recipe, stage).map(|how| format!("was made {how}"))
                }
                Err(Error::Tile { why, .. }) => Some(why),
                Err(error) => return Err(error),
            };
            match why {
                None => drop(own.insert(shard)),
                Some(why) => others.push(format!("that of shard {shard} {why}")),
            }
        }
        self.remove_shards(stage, own)?;
        Ok(others.first().map(|first| {
            format!(
                "tiles of {stage} stay in {}, because {first}: give the options of its shards \
                with `stage.redo` {stage} to take them, or delete them",
                self.root().join(TILES).display()
            )
        }))
    }

    /// Removes the tiles that a stage made for itself, whatever their recipe.
    ///
    /// # Errors
    ///
    /// They cannot be read or removed.
    pub(crate) fn remove_own_tiles(&self, stage: Stage) -> Result<(), Error> {
        let mut own = BTreeSet::new();
        for shard in self.with_tiles(stage) {
            match self.labelled(stage, shard, TileReader::open_unchecked) {
                Ok((_, label)) => drop(label.is_own.then(|| own.insert(shard))),
                // Whose it is cannot be told.
                Err(Error::Tile { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        self.remove_shards(stage, own)
    }

    /// Removes the tiles of shards, what killed shards had begun, and the folder if it is empty
    /// then.
    fn remove_shards(&self, stage: Stage, shards: BTreeSet<Shard>) -> Result<(), Error> {
        let folder = self.folder.folder();
        let failed = || StoreError::output(&folder.join(TILES));
        // No link is followed to files of others.
        if !folder.metadata(TILES).map_err(failed())?.is_some_and(|found| found.is_dir()) {
            return Ok(());
        }
        let mut names = self.in_tiles(|name| begun_name(name, stage));
        names.extend(shards.into_iter().map(|shard| tile_name(stage, shard)));
        names.iter().try_for_each(|name| folder.remove_file(name)).map_err(failed())?;
        folder.remove_empty_folder(TILES).map_err(failed())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tiles_round_trip() {
        let shard: Shard = "2/8".parse().unwrap();
        assert_eq!(shard.to_string(), "2/8");
        assert_eq!(tile_name(Stage::Match, shard), ".tiepoint-tiles/match-2-of-8");
        assert_eq!(shard_of("match-2-of-8", Stage::Match), Some(shard));
        assert_eq!(shard_of("match-2-of-8", Stage::Features), None);
        for other in ["match-02-of-8", "match-2-of-08", "match-2/8", "match-9-of-8"] {
            assert_eq!(shard_of(other, Stage::Match), None, "{other}");
        }
        let begun = ".match-2-of-8.tiepoint-part";
        assert_eq!(shard_of(begun, Stage::Match), None);
        assert_eq!(begun_name(begun, Stage::Match), Some(format!("{TILES}/{begun}")));
        assert_eq!(begun_name(begun, Stage::Map), None);
        for other in ["match-2-of-8", ".match-2-of-8", ".match-2-of-8.tmp"] {
            assert_eq!(begun_name(other, Stage::Match), None, "{other}");
        }
    }

    fn recipe(photos: &str) -> Recipe {
        Recipe::new("input".to_owned(), [("found.photos", photos.to_owned())])
    }

    fn shard() -> Shard {
        "1/1".parse().unwrap()
    }

    #[test]
    fn label_differs_if_what_was_found_does() {
        let label = |photos: &str| Label::new(Stage::Features, shard(), &recipe(photos));
        assert_eq!(label("a").why_not(&label("a")), None);
        assert_eq!(label("a").why_not(&label("b")).unwrap(), "was made from other photos");
    }

    fn workspace() -> (tempfile::TempDir, Workspace) {
        let dir = tempfile::tempdir().unwrap();
        let workspace = Workspace::create(&dir.path().join("ws")).unwrap();
        (dir, workspace)
    }

    #[test]
    fn tile_of_another_build_of_the_version_is_refused() {
        let (_dir, workspace) = workspace();
        let (stage, recipe) = (Stage::Match, recipe("a"));
        let mut label = serde_json::to_value(Label::new(stage, shard(), &recipe)).unwrap();
        let mut refused = |format: Option<u32>| {
            let fields = label.as_object_mut().unwrap();
            fields.remove("format");
            fields.extend(format.map(|format| ("format".to_owned(), format.into())));
            let label = serde_json::from_value(label.clone()).unwrap();
            workspace.new_tile(stage, shard(), &label).unwrap().finish().unwrap();
            let found = workspace.check_tiles(stage, &recipe);
            found.map(drop).map_err(|error| error.to_string())
        };
        assert_eq!(refused(Some(FORMAT)), Ok(()));
        for (format, number) in [(None, 0), (Some(FORMAT + 1), FORMAT + 1)] {
            let error = refused(format).unwrap_err();
            let what = format!(
                "match-1-of-1 was made by another build of this version, with tiles \
                of format {number} and not {FORMAT}"
            );
            assert!(error.contains(&what), "{error}");
        }
    }

    #[test]
    fn tiles_that_a_stage_made_for_itself_are_no_obstacle() {
        let (_dir, workspace) = workspace();
        let (stage, [old, new]) = (Stage::Map, ["a", "b"].map(recipe));
        let is_there =
            |recipe: &Recipe| workspace.tile_of(stage, shard(), recipe).map(|tile| tile.is_some());
        workspace.own_tile(stage, shard(), &old).unwrap().finish().unwrap();
        assert!(is_there(&old).unwrap() && !is_there(&new).unwrap());
        workspace.remove_own_tiles(stage).unwrap();
        assert!(!is_there(&old).unwrap());
        // That of a process for the shard is.
        let label = Label::new(stage, shard(), &old);
        workspace.new_tile(stage, shard(), &label).unwrap().finish().unwrap();
        workspace.remove_own_tiles(stage).unwrap();
        assert!(is_there(&old).unwrap());
        assert!(matches!(is_there(&new), Err(Error::Tile { .. })));
    }

    /// Bytes that this thread has read from files.
    #[cfg(target_os = "linux")]
    fn bytes_read() -> usize {
        let counters = fs::read_to_string("/proc/thread-self/io").unwrap();
        counters.lines().find_map(|line| line.strip_prefix("rchar: ")).unwrap().parse().unwrap()
    }

    /// Once for its hash and once for its content.
    #[cfg(target_os = "linux")]
    #[test]
    fn tile_of_a_complete_stage_is_read_twice_at_most() {
        const STATE_BYTES: usize = 1 << 22;
        let (_dir, workspace) = workspace();
        let (stage, recipe) = (Stage::Match, recipe("a"));
        let label = Label::new(stage, shard(), &recipe);
        let mut tile = workspace.new_tile(stage, shard(), &label).unwrap();
        tile.write_state(&vec![7; STATE_BYTES]).unwrap();
        tile.finish().unwrap();
        let before = bytes_read();
        let tiles = workspace.check_tiles(stage, &recipe).unwrap();
        let mut taken = 0;
        let take = |mut tile: TileReader| {
            taken += tile.read_state()?.len();
            Ok(())
        };
        workspace.for_each_tile(&tiles, take).unwrap();
        assert_eq!(workspace.remove_tiles_of(stage, &recipe).unwrap(), None);
        assert!(workspace.with_tiles(stage).is_empty());
        assert_eq!(taken, STATE_BYTES);
        let times = (bytes_read() - before) as f64 / STATE_BYTES as f64;
        // What is read of the folder and of the labels is a hundredth.
        assert!(times < 2.1, "{times} times");
    }
}
