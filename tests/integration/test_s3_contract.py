"""A bucket on a real S3 server keeps the contract that buckets in memory and in folders keep."""

import pytest

from schemas.bucket import Bucket, open_bucket
from tests.contracts.bucket_contract import BucketContract
from tests.integration.object_store import Ceph

pytestmark = [pytest.mark.integration, pytest.mark.acceptance]


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
