//! SQLite's way to the disk, with faults: the usual one behind [`before`], for databases, journals
//! and logs. The index of a log is memory that processes share, and is passed through.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::io;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Once;

use rusqlite::ffi::{self, sqlite3_file, sqlite3_int64, sqlite3_io_methods, sqlite3_vfs};

use super::{Operation, before, faults};

const NAME: &CStr = c"tiepoint-faults";
const WATCHED: c_int =
    ffi::SQLITE_OPEN_MAIN_DB | ffi::SQLITE_OPEN_MAIN_JOURNAL | ffi::SQLITE_OPEN_WAL;
/// Bytes before the usual file; a multiple of every alignment.
const INNER: usize = size_of::<OuterFile>().next_multiple_of(16);

/// What SQLite takes for its file; the usual file follows.
#[repr(C)]
struct OuterFile {
    base: sqlite3_file,
    /// From `Box::into_raw`; null where the file is not watched.
    path: *mut PathBuf,
}

/// The name of the way, which is registered with SQLite.
pub(crate) fn name() -> &'static CStr {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // SAFETY: SQLite's own way to the disk lives as long as the program, and its description
        // may be copied; the copy is leaked, so that it lives as long. The functions that are
        // copied do not look at the description they are given; those that do are replaced and give
        // the usual one.
        unsafe {
            let usual = ffi::sqlite3_vfs_find(ptr::null());
            if usual.is_null() {
                return;
            }
            let faulty = Box::leak(Box::new(*usual));
            faulty.szOsFile += INNER as c_int;
            faulty.pNext = ptr::null_mut();
            faulty.zName = NAME.as_ptr();
            faulty.pAppData = usual.cast();
            faulty.xOpen = Some(open);
            faulty.xDelete = Some(delete);
            ffi::sqlite3_vfs_register(faulty, 0);
        }
    });
    NAME
}

/// SQLite's number for an error.
fn code(error: &io::Error, otherwise: c_int) -> c_int {
    if error.kind() == io::ErrorKind::StorageFull { ffi::SQLITE_FULL } else { otherwise }
}

/// # Safety
///
/// `name` is null or a string that ends with a zero.
unsafe fn path_of(name: *const c_char) -> Option<PathBuf> {
    if name.is_null() {
        return None;
    }
    // SAFETY: as said above.
    let name = unsafe { CStr::from_ptr(name) };
    #[cfg(unix)]
    let path =
        Path::new(<std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(name.to_bytes()));
    #[cfg(not(unix))]
    let path = Path::new(name.to_str().ok()?);
    Some(path.to_owned())
}

/// # Safety
///
/// `file` has the size that we told SQLite.
unsafe fn inner(file: *mut sqlite3_file) -> *mut sqlite3_file {
    // SAFETY: the usual file lies behind ours.
    unsafe { file.byte_add(INNER) }
}

/// # Safety
///
/// `file` was opened by [`open`].
unsafe fn outer_path<'a>(file: *mut sqlite3_file) -> Option<&'a Path> {
    // SAFETY: `open` has filled it, and `close` alone ends it.
    unsafe { (*file.cast::<OuterFile>()).path.as_ref().map(PathBuf::as_path) }
}

unsafe extern "C" fn open(
    vfs: *mut sqlite3_vfs,
    name: ffi::sqlite3_filename,
    file: *mut sqlite3_file,
    flags: c_int,
    out_flags: *mut c_int,
) -> c_int {
    // SAFETY: SQLite gives a description that is ours, a name or null, and room of the size that we
    // told.
    unsafe {
        let outer = file.cast::<OuterFile>();
        ptr::write(
            outer,
            OuterFile { base: sqlite3_file { pMethods: ptr::null() }, path: ptr::null_mut() },
        );
        let path = path_of(name).filter(|_| flags & WATCHED != 0);
        if let Some(path) =
            path.as_ref().filter(|path| flags & ffi::SQLITE_OPEN_CREATE != 0 && !path.exists())
            && let Err(error) = before(Operation::Create, path)
        {
            return code(&error, ffi::SQLITE_CANTOPEN);
        }
        let usual = (*vfs).pAppData.cast::<sqlite3_vfs>();
        let Some(usual_open) = (*usual).xOpen else { return ffi::SQLITE_CANTOPEN };
        let result = usual_open(usual, name, inner(file), flags, out_flags);
        if result == ffi::SQLITE_OK {
            (*outer).base.pMethods = &raw const METHODS;
            (*outer).path = path.map_or(ptr::null_mut(), |path| Box::into_raw(Box::new(path)));
        }
        result
    }
}

unsafe extern "C" fn delete(vfs: *mut sqlite3_vfs, name: *const c_char, sync: c_int) -> c_int {
    // SAFETY: SQLite gives a description that is ours, and a name.
    unsafe {
        if let Some(path) = path_of(name)
            && let Err(error) = before(Operation::Remove, &path)
        {
            return code(&error, ffi::SQLITE_IOERR_DELETE);
        }
        let usual = (*vfs).pAppData.cast::<sqlite3_vfs>();
        (*usual).xDelete.map_or(ffi::SQLITE_IOERR_DELETE, |delete| delete(usual, name, sync))
    }
}

unsafe extern "C" fn close(file: *mut sqlite3_file) -> c_int {
    // SAFETY: the file is open, and SQLite does not use it after that.
    unsafe {
        let outer = file.cast::<OuterFile>();
        let path = std::mem::replace(&mut (*outer).path, ptr::null_mut());
        if !path.is_null() {
            drop(Box::from_raw(path));
        }
        let usual = inner(file);
        (*(*usual).pMethods).xClose.map_or(ffi::SQLITE_OK, |close| close(usual))
    }
}

unsafe extern "C" fn write(
    file: *mut sqlite3_file,
    bytes: *const c_void,
    count: c_int,
    offset: sqlite3_int64,
) -> c_int {
    // SAFETY: the file is open, and `bytes` are `count`; half of them are no more.
    unsafe {
        let usual = inner(file);
        let Some(write) = (*(*usual).pMethods).xWrite else { return ffi::SQLITE_IOERR_WRITE };
        if let Some(path) = outer_path(file)
            && let Err(error) = before(Operation::Write, path)
        {
            let half = faults::torn(path, count as usize) as c_int;
            if half > 0 {
                let _ = write(usual, bytes, half, offset);
            }
            return code(&error, ffi::SQLITE_IOERR_WRITE);
        }
        write(usual, bytes, count, offset)
    }
}

unsafe extern "C" fn truncate(file: *mut sqlite3_file, size: sqlite3_int64) -> c_int {
    // SAFETY: the file is open.
    unsafe {
        if let Some(path) = outer_path(file)
            && let Err(error) = before(Operation::Write, path)
        {
            // There is no half of a size.
            let _ = faults::torn(path, 0);
            return code(&error, ffi::SQLITE_IOERR_TRUNCATE);
        }
        let usual = inner(file);
        (*(*usual).pMethods)
            .xTruncate
            .map_or(ffi::SQLITE_IOERR_TRUNCATE, |truncate| truncate(usual, size))
    }
}

unsafe extern "C" fn sync(file: *mut sqlite3_file, flags: c_int) -> c_int {
    // SAFETY: the file is open.
    unsafe {
        if let Some(path) = outer_path(file)
            && let Err(error) = before(Operation::Sync, path)
        {
            return code(&error, ffi::SQLITE_IOERR_FSYNC);
        }
        let usual = inner(file);
        (*(*usual).pMethods).xSync.map_or(ffi::SQLITE_IOERR_FSYNC, |sync| sync(usual, flags))
    }
}

/// Functions that hand on their arguments to those of the usual file.
macro_rules! pass_through {
    ($($name:ident = $method:ident($($argument:ident: $type:ty),*);)*) => {$(
        unsafe extern "C" fn $name(file: *mut sqlite3_file, $($argument: $type),*) -> c_int {
            // SAFETY: the file is open, and the arguments are as the usual function wants them.
            unsafe {
                let usual = inner(file);
                let method = (*(*usual).pMethods).$method;
                method.map_or(ffi::SQLITE_ERROR, |method| method(usual, $($argument),*))
            }
        }
    )*};
}

pass_through! {
    read = xRead(bytes: *mut c_void, count: c_int, offset: sqlite3_int64);
    file_size = xFileSize(size: *mut sqlite3_int64);
    lock = xLock(level: c_int);
    unlock = xUnlock(level: c_int);
    check_reserved_lock = xCheckReservedLock(result: *mut c_int);
    file_control = xFileControl(operation: c_int, argument: *mut c_void);
    sector_size = xSectorSize();
    device_characteristics = xDeviceCharacteristics();
    shm_map = xShmMap(page: c_int, size: c_int, extend: c_int, memory: *mut *mut c_void);
    shm_lock = xShmLock(offset: c_int, count: c_int, flags: c_int);
    shm_unmap = xShmUnmap(delete: c_int);
}

unsafe extern "C" fn shm_barrier(file: *mut sqlite3_file) {
    // SAFETY: the file is open.
    unsafe {
        let usual = inner(file);
        if let Some(barrier) = (*(*usual).pMethods).xShmBarrier {
            barrier(usual);
        }
    }
}

static METHODS: sqlite3_io_methods = sqlite3_io_methods {
    iVersion: 2,
    xClose: Some(close),
    xRead: Some(read),
    xWrite: Some(write),
    xTruncate: Some(truncate),
    xSync: Some(sync),
    xFileSize: Some(file_size),
    xLock: Some(lock),
    xUnlock: Some(unlock),
    xCheckReservedLock: Some(check_reserved_lock),
    xFileControl: Some(file_control),
    xSectorSize: Some(sector_size),
    xDeviceCharacteristics: Some(device_characteristics),
    xShmMap: Some(shm_map),
    xShmLock: Some(shm_lock),
    xShmBarrier: Some(shm_barrier),
    xShmUnmap: Some(shm_unmap),
    xFetch: None,
    xUnfetch: None,
};
