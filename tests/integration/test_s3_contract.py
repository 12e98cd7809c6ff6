"""A bucket on a real S3 server keeps the contract that buckets in memory and in folders keep."""

import obstore
import pytest

from schemas.errors import ObjectChangedError
from schemas.transport.bucket import Bucket, open_bucket
from tests.contracts.bucket_contract import BucketContract
from tests.integration.faulty_proxy import FaultyProxy
from tests.integration.object_store import Ceph

pytestmark = pytest.mark.integration


class TestS3Bucket(BucketContract):
    @pytest.fixture(autouse=True)
    def _ceph(self, ceph: Ceph) -> None:
        self.ceph = ceph

    def make_bucket(self) -> Bucket:
        return self.ceph.open(self.ceph.make_bucket())


class TestFolderOfAnS3Bucket(BucketContract):
    @pytest.fixture(autouse=True)
    def _ceph(self, ceph: Ceph) -> None:
        self.ceph = ceph

    def make_bucket(self) -> Bucket:
        name = self.ceph.make_bucket()
        self.ceph.open(name).put("elsewhere/x", b"x")
        self.ceph.open(name).put("zz", b"x")
        return open_bucket(f"s3://{name}/fleet a/2026", options=self.ceph.options())


def test_an_object_that_is_deleted_in_mid_read_has_changed(ceph: Ceph) -> None:
    name, size = ceph.make_bucket(), 100_000
    ceph.open(name).put("log", bytes(size))
    with FaultyProxy(ceph.endpoint) as proxy:
        options = ceph.options() | {"endpoint": proxy.endpoint}
        bucket = open_bucket(f"s3://{name}", options=options)
        (found,) = bucket.list()
        proxy.in_next_body("log", lambda: obstore.delete(ceph.store(name), "log"))
        with pytest.raises(ObjectChangedError):
            bucket.read_range("log", 0, size, found.etag)
