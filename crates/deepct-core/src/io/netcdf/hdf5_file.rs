//! HDF5 files: the variables of all groups, their dimensions, attributes and values.

use super::container::{Attribute, Kind, Real};
use super::guard;
use super::{dimension, reason};
use crate::error::{Error, Result};
use hdf5::filters::Filter;
use hdf5::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{
    Dataset, Group, H5Type, Hyperslab, LinkInfo, LinkType, Location, LocationToken, SliceOrIndex,
};
use ndarray::ArrayD;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The first bytes of an HDF5 file, at offset 0, 512, 1024, ...: in front of them other programs keep
/// a block of their own.
const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// The offsets at which the signature is searched.
const OFFSETS: u32 = 24;
/// Maximum length of a text attribute of fixed length (bytes).
const LONGEST_TEXT: usize = 4096;
/// Maximum length of a text of fixed length that is a value (bytes).
const LONGEST_NAME: usize = 64;
/// Depth of groups, and their number, beyond which groups are not listed.
const DEEPEST: usize = 16;
const MOST_GROUPS: usize = 10_000;
/// The prefix that the netCDF library gives to a variable that has the name of a dimension and is not
/// its coordinate.
const NOT_A_COORDINATE: &str = "_nc4_non_coord_";
/// The number of the filter szip.
const SZIP: i32 = 4;
/// The name of the scale of a dimension without coordinates.
const NO_COORDINATES: &str = "This is a netCDF dimension but not a netCDF variable";

/// An open HDF5 file.
pub(super) struct Hdf5 {
    path: PathBuf,
    file: hdf5::File,
    variables: BTreeMap<String, Dataset>,
    /// The scales of the dimensions, by the path of the dimension.
    scales: Vec<(String, Dataset)>,
    /// The paths of objects that cannot be opened.
    unreadable: Vec<String>,
}

impl Hdf5 {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let file = hdf5::File::open(path).map_err(|error| cannot_open(path, &error.to_string()))?;
        guard::check_links(path, &file)?;
        let mut listed = Self {
            path: path.into(),
            variables: BTreeMap::new(),
            scales: Vec::new(),
            unreadable: Vec::new(),
            file: file.clone(),
        };
        listed.list(&file, "", DEEPEST, &mut Vec::new()).map_err(|_| {
            let problem = "is damaged: its contents cannot be listed";
            Error::file(path, "file", problem, "copy it again from its source")
        })?;
        Ok(listed)
    }

    /// List the variables of a group and of the groups in it.
    fn list(
        &mut self,
        group: &Group,
        prefix: &str,
        depth: usize,
        groups: &mut Vec<LocationToken>,
    ) -> hdf5::Result<()> {
        let visit = |_: &Group, name: &str, link: LinkInfo, links: &mut Vec<(String, LinkType)>| {
            links.push((name.to_owned(), link.link_type));
            true
        };
        for (name, link) in group.iter_visit_default(Vec::new(), visit)? {
            let path = format!("{prefix}{name}");
            if let Ok(dataset) = group.dataset(&name) {
                self.add(prefix, &name, dataset);
            } else if link != LinkType::Hard {
                // A link to a group could lead back to where it is, and one without an end is usual.
            } else if let Ok(inner) = group.group(&name) {
                let token = inner.loc_info().map(|info| info.token);
                let known = token.as_ref().is_ok_and(|token| groups.contains(token));
                if depth > 0 && !known && groups.len() < MOST_GROUPS {
                    groups.extend(token);
                    // A group that cannot be listed has no variables that can be read.
                    let _ = self.list(&inner, &format!("{path}/"), depth - 1, groups);
                }
            } else if group.loc_type_by_name(&name).ok() != Some(hdf5::LocationType::NamedDatatype)
            {
                self.unreadable.push(path);
            }
        }
        Ok(())
    }

    fn add(&mut self, prefix: &str, name: &str, dataset: Dataset) {
        // The library's own test frees memory twice if the attribute is damaged.
        let class = text_attribute(&dataset, "CLASS");
        let is_scale = class.is_some_and(|class| class == "DIMENSION_SCALE");
        if is_scale {
            self.scales.push((format!("{prefix}{name}"), dataset.clone()));
        }
        let name_of_scale = || text_attribute(&dataset, "NAME").unwrap_or_default();
        if !(is_scale && name_of_scale().starts_with(NO_COORDINATES)) {
            let name = name.strip_prefix(NOT_A_COORDINATE).unwrap_or(name);
            self.variables.insert(format!("{prefix}{name}"), dataset);
        }
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.variables.keys().cloned().collect()
    }

    pub(super) fn variable(&self, name: &str) -> Result<Option<&Dataset>> {
        let name = name.trim_start_matches('/');
        if self.unreadable.iter().any(|path| path == name) {
            return Err(self.newer(name));
        }
        let Some(dataset) = self.variables.get(name) else { return Ok(None) };
        guard::check_storage(&self.path, name, dataset)?;
        Ok(Some(dataset))
    }

    pub(super) fn unreadable(&self) -> Option<Error> {
        self.unreadable.first().map(|name| self.newer(name))
    }

    fn newer(&self, name: &str) -> Error {
        let reason = self.file.dataset(name).map_err(|error| error.to_string()).err();
        let (problem, remedy) = match reason.unwrap_or_default() {
            text if text.contains("version") => (
                "is written in a newer HDF5 format (2.0)",
                "write it again in the format of HDF5 1.14, with libver=(\"earliest\", \"v114\") in \
                 h5py, or copy it with `nccopy -k nc4`",
            ),
            _ => (
                "cannot be opened: it is damaged, or in a newer HDF5 format",
                "copy the file again from its source, or write it in the format of HDF5 1.14",
            ),
        };
        Error::file(&self.path, name, problem, remedy)
    }

    pub(super) fn dimensions(&self, name: &str, dataset: &Dataset) -> Vec<Option<String>> {
        let axes = dataset.ndim();
        let group = name.rsplit_once('/').map_or(String::new(), |(group, _)| format!("{group}/"));
        if axes == 1 && self.scales.iter().any(|(scale, _)| scale == name) {
            return vec![Some(name.to_owned())];
        }
        let mut names: Vec<Option<String>> = vec![None; axes];
        for (name, attached) in names.iter_mut().zip(dimension::attached_scales(dataset)) {
            let is_attached =
                |scale: &Dataset| scale.loc_info().is_ok_and(|info| attached.contains(&info.token));
            let found = self.scales.iter().find(|(_, scale)| is_attached(scale));
            *name = found.map(|(name, _)| name.clone());
        }
        // The netCDF library numbers its dimensions, also where no scale can be attached.
        if let Some(Attribute::Numbers(ids, _)) = attribute(dataset, "_Netcdf4Coordinates") {
            let with_id = |id: f64| {
                let has = |scale: &Dataset| {
                    let own = attribute(scale, "_Netcdf4Dimid");
                    matches!(own, Some(Attribute::Numbers(own, _)) if own == [id])
                };
                let mut scales = self.scales.iter();
                // A group has dimensions of its own and those of the groups around it.
                scales.rfind(|(path, scale)| {
                    let place = path.rsplit_once('/').map_or("", |(place, _)| place);
                    let around = place.is_empty() || group.starts_with(&format!("{place}/"));
                    around && has(scale)
                })
            };
            for (name, id) in names.iter_mut().zip(ids) {
                *name = name.take().or_else(|| with_id(id).map(|(name, _)| name.clone()));
            }
        }
        names
    }

    pub(super) fn attribute(&self, group: &str, name: &str) -> Option<Attribute> {
        let group = self.file.group(group).ok()?;
        attribute(&group, name)
    }
}

/// The reason why a file cannot be opened, and what helps.
fn cannot_open(path: &Path, reason: &str) -> Error {
    let unusable = |problem: &str, remedy: &str| Error::file(path, "file", problem, remedy);
    let Some((offset, start)) = signature(path) else {
        return unusable("is not an HDF5 or netCDF file", "give a file of that format");
    };
    if reason.contains("already open for write") {
        return unusable(
            "is open for writing in another program, or was left so by one that was stopped",
            "close it there; if no program has it open, run `h5clear -s` on a copy of it",
        );
    }
    if reason.contains("unable to lock file") {
        return unusable(
            "is open in another program, which locks it",
            "close it there, or copy it",
        );
    }
    // The version of the superblock follows the signature.
    if start.get(SIGNATURE.len()).is_some_and(|version| *version > 3) {
        return unusable("is in a newer HDF5 format", "write it again in that of HDF5 1.14");
    }
    let block =
        if offset > 0 { format!(" after a block of {offset} bytes") } else { String::new() };
    unusable(
        &format!("is truncated or damaged{block}"),
        "copy it again from its source, or write it again if its writer was stopped",
    )
}

/// Whether a file is HDF5, possibly behind a block of another program.
pub(crate) fn is_hdf5(path: &Path) -> bool {
    signature(path).is_some()
}

/// The offset of the signature of HDF5, and the bytes that start there.
fn signature(path: &Path) -> Option<(u64, Vec<u8>)> {
    let offsets = std::iter::once(0).chain((9..9 + OFFSETS).map(|power| 1_u64 << power));
    let mut starts = offsets.map(|offset| (offset, first_bytes(path, offset).unwrap_or_default()));
    starts.find(|(_, start)| start.starts_with(SIGNATURE))
}

/// The sixteen bytes from `offset` on, or fewer if the file ends.
pub(super) fn first_bytes(path: &Path, offset: u64) -> Result<Vec<u8>> {
    use std::io::{Read, Seek, SeekFrom};
    let mut bytes = Vec::new();
    let mut file = std::fs::File::open(path).map_err(Error::io(path))?;
    file.seek(SeekFrom::Start(offset)).map_err(Error::io(path))?;
    file.take(16).read_to_end(&mut bytes).map_err(Error::io(path))?;
    Ok(bytes)
}

pub(super) fn kind(dataset: &Dataset) -> Kind {
    match dataset.dtype().and_then(|kind| kind.to_descriptor()) {
        Ok(TypeDescriptor::Float(size)) => Kind::Float(size as usize),
        Ok(TypeDescriptor::Integer(size)) => Kind::Signed(size as usize),
        Ok(TypeDescriptor::Unsigned(size)) => Kind::Unsigned(size as usize),
        Ok(TypeDescriptor::Boolean) => Kind::Boolean,
        Ok(other) => Kind::Other(other.to_string()),
        Err(_) => Kind::Other("unsupported".into()),
    }
}

pub(super) fn attribute(on: &Location, name: &str) -> Option<Attribute> {
    let attribute = on.attr(name).ok()?;
    let kind = attribute.dtype().and_then(|kind| kind.to_descriptor()).ok()?;
    let real = matches!(kind, TypeDescriptor::Float(_));
    match kind {
        TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_) => {
            let fits = attribute.size() <= LONGEST_TEXT;
            let numbers = fits.then(|| attribute.read_raw::<f64>().ok()).flatten()?;
            Some(Attribute::Numbers(numbers, real))
        }
        _ => text_attribute(on, name).map(Attribute::Text),
    }
}

/// The value of a text attribute. HDF5 does not convert between the four string types, so each
/// is read with its own type.
fn text_attribute(on: &Location, name: &str) -> Option<String> {
    let attribute = on.attr(name).ok()?;
    if attribute.size() != 1 {
        return None;
    }
    let text = match attribute.dtype().ok()?.to_descriptor().ok()? {
        TypeDescriptor::FixedAscii(length) if length <= LONGEST_TEXT => {
            decoded(attribute.read_raw::<FixedAscii<LONGEST_TEXT>>().ok()?[0].as_bytes())
        }
        TypeDescriptor::FixedUnicode(length) if length <= LONGEST_TEXT => {
            decoded(attribute.read_raw::<FixedUnicode<LONGEST_TEXT>>().ok()?[0].as_bytes())
        }
        TypeDescriptor::VarLenAscii => {
            decoded(attribute.read_raw::<VarLenAscii>().ok()?[0].as_bytes())
        }
        TypeDescriptor::VarLenUnicode => {
            decoded(attribute.read_raw::<VarLenUnicode>().ok()?[0].as_bytes())
        }
        _ => return None,
    };
    Some(text.trim().to_owned())
}

/// Text in UTF-8 or, if it is none, in Latin-1, in which older programs write the micro sign. HDF5
/// does not check what a file declares as UTF-8.
pub(super) fn decoded(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
    }
}

/// All values of a dataset of text; `None` if they cannot be read as such.
pub(super) fn texts(dataset: &Dataset) -> Option<Vec<String>> {
    fn all<T: H5Type>(dataset: &Dataset, bytes: impl Fn(&T) -> &[u8]) -> Option<Vec<String>> {
        let values = dataset.read_raw::<T>().ok()?;
        Some(values.iter().map(|value| decoded(bytes(value)).trim().to_owned()).collect())
    }
    match dataset.dtype().ok()?.to_descriptor().ok()? {
        TypeDescriptor::FixedAscii(length) if length <= LONGEST_NAME => {
            all::<FixedAscii<LONGEST_NAME>>(dataset, |text| text.as_bytes())
        }
        TypeDescriptor::FixedUnicode(length) if length <= LONGEST_NAME => {
            all::<FixedUnicode<LONGEST_NAME>>(dataset, |text| text.as_bytes())
        }
        TypeDescriptor::VarLenAscii => all::<VarLenAscii>(dataset, |text| text.as_bytes()),
        TypeDescriptor::VarLenUnicode => all::<VarLenUnicode>(dataset, |text| text.as_bytes()),
        _ => None,
    }
}

pub(super) fn read<T: Real>(
    dataset: &Dataset,
    ranges: &[Range<usize>],
) -> std::result::Result<ArrayD<T>, (String, String)> {
    if ranges.is_empty() {
        return dataset.read_dyn().map_err(|error| failure(dataset, &error));
    }
    let slab: Vec<_> = ranges
        .iter()
        .map(|range| SliceOrIndex::SliceCount {
            start: range.start,
            step: 1,
            count: range.len(),
            block: 1,
        })
        .collect();
    dataset
        .read_slice::<T, _, ndarray::IxDyn>(Hyperslab::from(slab))
        .map_err(|error| failure(dataset, &error))
}

/// The problem of values that cannot be read, and its remedy.
pub(super) fn failure(dataset: &Dataset, error: &hdf5::Error) -> (String, String) {
    let text = error.to_string();
    let filters = dataset.filters();
    let installed = |filter: &Filter| filter.is_available();
    match filters.iter().find(|filter| !installed(filter)) {
        None => (
            format!("cannot be read: {}", reason(&text)),
            "the file is truncated or damaged; copy it again or write it again".into(),
        ),
        Some(filter) => (
            format!("is compressed with {}, which is not installed", filter_name(filter.id())),
            match filter.id() {
                SZIP => "rewrite it with deflate: `h5repack -f GZIP=4 IN OUT`".into(),
                _ => "run `pip install hdf5plugin` and set HDF5_PLUGIN_PATH to the folder that \
                      `python -c \"import hdf5plugin; print(hdf5plugin.PLUGIN_PATH)\"` prints, or \
                      rewrite it with deflate: `nccopy -F none -d 4 IN OUT`"
                    .into(),
            },
        ),
    }
}

/// The name of a filter by its registered number.
fn filter_name(id: i32) -> String {
    const NAMES: [(i32, &str); 13] = [
        (SZIP, "szip"),
        (307, "bzip2"),
        (32000, "lzf"),
        (32001, "blosc"),
        (32004, "lz4"),
        (32008, "bitshuffle"),
        (32013, "zfp"),
        (32015, "zstd"),
        (32016, "sz"),
        (32017, "sz"),
        (32022, "bitgroom"),
        (32024, "sz3"),
        (32026, "blosc2"),
    ];
    let known = NAMES.iter().find(|(known, _)| *known == id);
    known.map_or_else(|| format!("filter {id}"), |(_, name)| (*name).to_owned())
}
