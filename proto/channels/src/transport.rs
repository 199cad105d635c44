//! iceoryx2 as this program uses it: between processes, in files of a private directory.
//!
//! Everything is as in [`iceoryx2::prelude::ipc`], except where memory is shared: not in POSIX shared
//! memory, whose names all users see, but in [segments](crate::segment) under the root path, which is
//! a directory that only its owner may enter.

use std::fmt::Debug;

use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::unique_id_generator::unique_system_id::UniqueSystemId;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_lock_free::mpmc::counting_bit_set::RelocatableCountingBitSet;
use iceoryx2_cal::event::trigger::State;
use iceoryx2_cal::event::trigger::unix_datagram_socket::GenericUnixDatagramSocketTrigger;
use iceoryx2_cal::resizable_shared_memory::dynamic::DynamicMemory;
use iceoryx2_cal::shared_memory::common::details::{AllocatorDetails, Memory};
use iceoryx2_cal::shm_allocator::bump_allocator::BumpAllocator;
use iceoryx2_cal::shm_allocator::pool_allocator::PoolAllocator;
use iceoryx2_cal::zero_copy_connection::common::details::{Connection, SharedManagementData};
use iceoryx2_cal::{arc_sync_policy, bag, hash, monitoring, reactor, serialize, static_storage};

use crate::segment::Segment;

/// The variant of iceoryx2's services.
#[derive(Debug, Clone)]
pub(crate) struct Private {}

impl Service for Private {
    type StaticStorage = static_storage::recommended::Ipc;
    type ConfigSerializer = serialize::recommended::Recommended;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Segment<T>;
    type Bag = bag::recommended::Recommended;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Segment<T>;
    type ServiceNameHasher = hash::recommended::Recommended;
    type SharedMemory = Memory<PoolAllocator, Segment<AllocatorDetails<PoolAllocator>>>;
    type ResizableSharedMemory = DynamicMemory<PoolAllocator, Self::SharedMemory>;
    type Connection = Connection<Segment<SharedManagementData>>;
    type Event = GenericUnixDatagramSocketTrigger<
        RelocatableCountingBitSet,
        Segment<State<RelocatableCountingBitSet, ()>>,
    >;
    type Monitoring = monitoring::recommended::Ipc;
    type Reactor = reactor::recommended::Ipc;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> =
        arc_sync_policy::single_threaded::SingleThreaded<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> = Segment<T>;
    type BlackboardPayload = Memory<BumpAllocator, Segment<AllocatorDetails<BumpAllocator>>>;
    type UniqueId = UniqueSystemId;
}

impl ServiceInternal<Self> for Private {}
