//! A VFS of SQLite with injected faults: the default VFS behind [`check_fault`], for databases,
//! journals and logs. The index of a log (`-shm`) is shared memory and is passed through.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::io;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::Once;

use rusqlite::ffi::{self, sqlite3_file, sqlite3_int64, sqlite3_io_methods, sqlite3_vfs};
use tiepoint_store::disk::{Operation, check_fault, faults};

const NAME: &CStr = c"tiepoint-faults";
const WATCHED: c_int =
    ffi::SQLITE_OPEN_MAIN_DB | ffi::SQLITE_OPEN_MAIN_JOURNAL | ffi::SQLITE_OPEN_WAL;
/// Offset of the file of the default VFS; a multiple of every alignment.
const INNER: usize = size_of::<OuterFile>().next_multiple_of(16);

/// The file of SQLite; the file of the default VFS follows in memory.
#[repr(C)]
struct OuterFile {
    base: sqlite3_file,
    /// From `Box::into_raw`; null for a file that is not watched.
    path: *mut PathBuf,
}

/// The name of the VFS, which is registered with SQLite at the first call.
pub(crate) fn name() -> &'static CStr {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // SAFETY: the default VFS lives as long as the program, and its description may be copied;
        // the copy is leaked, so that it lives as long. The copied functions do not use the
        // description that they are given; the functions that do are replaced and pass on the
        // default one.
        unsafe {
            let default_vfs = ffi::sqlite3_vfs_find(ptr::null());
            if default_vfs.is_null() {
                return;
            }
            let faulty_vfs = Box::leak(Box::new(*default_vfs));
            faulty_vfs.szOsFile += INNER as c_int;
            faulty_vfs.pNext = ptr::null_mut();
            faulty_vfs.zName = NAME.as_ptr();
            faulty_vfs.pAppData = default_vfs.cast();
            faulty_vfs.xOpen = Some(open);
            faulty_vfs.xDelete = Some(delete);
            ffi::sqlite3_vfs_register(faulty_vfs, 0);
        }
    });
    NAME
}

/// Error code of SQLite.
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
    // SAFETY: the contract of this function.
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
/// `file` has the size that we registered with SQLite.
unsafe fn inner(file: *mut sqlite3_file) -> *mut sqlite3_file {
    // SAFETY: the default file follows ours in memory.
    unsafe { file.byte_add(INNER) }
}

/// # Safety
///
/// `file` was opened by [`open`].
unsafe fn outer_path<'a>(file: *mut sqlite3_file) -> Option<&'a Path> {
    // SAFETY: `open` initialised it, and only `close` frees it.
    unsafe { (*file.cast::<OuterFile>()).path.as_ref().map(PathBuf::as_path) }
}

unsafe extern "C" fn open(
    vfs: *mut sqlite3_vfs,
    name: ffi::sqlite3_filename,
    file: *mut sqlite3_file,
    flags: c_int,
    out_flags: *mut c_int,
) -> c_int {
    // SAFETY: SQLite passes our description, a name or null, and memory of the size that we
    // registered.
    unsafe {
        let outer = file.cast::<OuterFile>();
        ptr::write(
            outer,
            OuterFile { base: sqlite3_file { pMethods: ptr::null() }, path: ptr::null_mut() },
        );
        let path = path_of(name).filter(|_| flags & WATCHED != 0);
        if let Some(path) =
            path.as_ref().filter(|path| flags & ffi::SQLITE_OPEN_CREATE != 0 && !path.exists())
            && let Err(error) = check_fault(Operation::Create, path)
        {
            return code(&error, ffi::SQLITE_CANTOPEN);
        }
        let default_vfs = (*vfs).pAppData.cast::<sqlite3_vfs>();
        let Some(default_open) = (*default_vfs).xOpen else { return ffi::SQLITE_CANTOPEN };
        let result = default_open(default_vfs, name, inner(file), flags, out_flags);
        if result == ffi::SQLITE_OK {
            (*outer).base.pMethods = &raw const METHODS;
            (*outer).path = path.map_or(ptr::null_mut(), |path| Box::into_raw(Box::new(path)));
        }
        result
    }
}

unsafe extern "C" fn delete(vfs: *mut sqlite3_vfs, name: *const c_char, sync: c_int) -> c_int {
    // SAFETY: SQLite passes our description and a name.
    unsafe {
        if let Some(path) = path_of(name)
            && let Err(error) = check_fault(Operation::Remove, &path)
        {
            return code(&error, ffi::SQLITE_IOERR_DELETE);
        }
        let default_vfs = (*vfs).pAppData.cast::<sqlite3_vfs>();
        (*default_vfs)
            .xDelete
            .map_or(ffi::SQLITE_IOERR_DELETE, |delete| delete(default_vfs, name, sync))
    }
}

unsafe extern "C" fn close(file: *mut sqlite3_file) -> c_int {
    // SAFETY: the file is open, and SQLite does not use it after this call.
    unsafe {
        let outer = file.cast::<OuterFile>();
        let path = std::mem::replace(&mut (*outer).path, ptr::null_mut());
        if !path.is_null() {
            drop(Box::from_raw(path));
        }
        let default_file = inner(file);
        (*(*default_file).pMethods).xClose.map_or(ffi::SQLITE_OK, |close| close(default_file))
    }
}

unsafe extern "C" fn write(
    file: *mut sqlite3_file,
    bytes: *const c_void,
    count: c_int,
    offset: sqlite3_int64,
) -> c_int {
    // SAFETY: the file is open, and `bytes` holds `count` bytes.
    unsafe {
        let default_file = inner(file);
        let Some(write) = (*(*default_file).pMethods).xWrite else {
            return ffi::SQLITE_IOERR_WRITE;
        };
        if let Some(path) = outer_path(file)
            && let Err(error) = check_fault(Operation::Write, path)
        {
            let half = faults::partial_write_len(path, count as usize) as c_int;
            if half > 0 {
                let _ = write(default_file, bytes, half, offset);
            }
            return code(&error, ffi::SQLITE_IOERR_WRITE);
        }
        write(default_file, bytes, count, offset)
    }
}

unsafe extern "C" fn truncate(file: *mut sqlite3_file, size: sqlite3_int64) -> c_int {
    // SAFETY: the file is open.
    unsafe {
        if let Some(path) = outer_path(file)
            && let Err(error) = check_fault(Operation::Write, path)
        {
            // A truncation has no partial effect.
            let _ = faults::partial_write_len(path, 0);
            return code(&error, ffi::SQLITE_IOERR_TRUNCATE);
        }
        let default_file = inner(file);
        (*(*default_file).pMethods)
            .xTruncate
            .map_or(ffi::SQLITE_IOERR_TRUNCATE, |truncate| truncate(default_file, size))
    }
}

unsafe extern "C" fn sync(file: *mut sqlite3_file, flags: c_int) -> c_int {
    // SAFETY: the file is open.
    unsafe {
        if let Some(path) = outer_path(file)
            && let Err(error) = check_fault(Operation::Sync, path)
        {
            return code(&error, ffi::SQLITE_IOERR_FSYNC);
        }
        let default_file = inner(file);
        (*(*default_file).pMethods)
            .xSync
            .map_or(ffi::SQLITE_IOERR_FSYNC, |sync| sync(default_file, flags))
    }
}

/// Defines functions that forward to the functions of the default file.
macro_rules! pass_through {
    ($($name:ident = $method:ident($($argument:ident: $type:ty),*);)*) => {$(
        unsafe extern "C" fn $name(file: *mut sqlite3_file, $($argument: $type),*) -> c_int {
            // SAFETY: the file is open, and the arguments fulfil the contract of the default
            // function.
            unsafe {
                let default_file = inner(file);
                let method = (*(*default_file).pMethods).$method;
                method.map_or(ffi::SQLITE_ERROR, |method| method(default_file, $($argument),*))
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
        let default_file = inner(file);
        if let Some(barrier) = (*(*default_file).pMethods).xShmBarrier {
            barrier(default_file);
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
