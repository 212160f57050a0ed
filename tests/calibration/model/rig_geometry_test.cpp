#include "calibration/model/rig_geometry.h"

#include <gtest/gtest.h>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

RigGeometry sample() {
  RigGeometry rig;
  rig.sceneCamera.camera = "scene";
  rig.sceneCamera.sceneFromCamera =
      Eigen::Translation3d(0.1, -0.2, 1.5) * Eigen::AngleAxisd(3.0, Eigen::Vector3d::UnitX());
  rig.sourceCameras.push_back(
      {"source", Eigen::Translation3d(0, 0.3, 0) *
                     Eigen::AngleAxisd(-1.2, Eigen::Vector3d(1, 2, 3).normalized())});
  rig.sourceCameras[0].covariance =
      Eigen::Matrix<double, 6, 1>(1e-6, 2e-6, 3e-6, 1e-8, 2e-8, 1e-7 / 3).asDiagonal();
  rig.lampRadiusMetres = 0.8;
  return rig;
}

TEST(RigGeometry, RoundTripIsExact) {
  const TemporaryFolder folder;
  const RigGeometry rig = sample();
  ASSERT_TRUE(saveRigGeometry(rig, folder / "rig.json"));
  const RigGeometry loaded = loadRigGeometry(folder / "rig.json").value();
  EXPECT_EQ(loaded.sceneCamera.camera, "scene");
  EXPECT_EQ(loaded.sceneCamera.sceneFromCamera.matrix(), rig.sceneCamera.sceneFromCamera.matrix());
  ASSERT_EQ(loaded.sourceCameras.size(), 1u);
  EXPECT_EQ(loaded.sourceCameras[0].sceneFromCamera.matrix(),
            rig.sourceCameras[0].sceneFromCamera.matrix());
  EXPECT_EQ(loaded.sourceCameras[0].covariance, rig.sourceCameras[0].covariance);
  EXPECT_TRUE(loaded.sceneCamera.covariance.isZero(0));
  EXPECT_EQ(loaded.lampRadiusMetres, 0.8);
}

TEST(RigGeometry, RefusesWhatIsNotARigWithField) {
  const Json good = rigGeometryToJson(sample());
  const auto complaint = [](const Json& json) {
    const auto rig = rigGeometryFromJson(json, "rig.json");
    return rig ? std::string("accepted") : rig.error().message;
  };
  ASSERT_EQ(complaint(good), "accepted");
  Json json = good;
  json["sceneCamera"]["rotation"][0] = 2;
  EXPECT_NE(complaint(json).find("not a rotation"), std::string::npos);
  json = good;
  for (int i = 0; i < 3; ++i) {
    json["sceneCamera"]["rotation"][i] = -json["sceneCamera"]["rotation"][i].get<double>();
  }
  EXPECT_NE(complaint(json).find("not a rotation"), std::string::npos);  // a mirror
  json = good;
  json["sourceCameras"] = Json::array();
  EXPECT_NE(complaint(json).find("sourceCameras"), std::string::npos);
  json = good;
  json["sourceCameras"][0]["covariance"][0] = -1;
  EXPECT_NE(complaint(json).find("covariance"), std::string::npos);
  json = good;
  json["lampRadiusMetres"] = -1;
  EXPECT_NE(complaint(json).find("lampRadiusMetres"), std::string::npos);
  json = good;
  json.erase("sceneCamera");
  EXPECT_NE(complaint(json).find("sceneCamera"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
