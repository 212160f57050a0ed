#include "calibration/lens/camera_formats.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "tests/capture/frame/temporary_folder.h"

extern "C" {
#include <mrcal/mrcal.h>
}

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

std::vector<Vector3d> directionsTo(double degrees) {
  std::vector<Vector3d> directions;
  for (double theta = 1; theta < degrees; theta += 3) {
    for (double phi = 0.1; phi < 6.28; phi += 0.5) {
      const double t = theta * std::numbers::pi / 180;
      directions.emplace_back(std::sin(t) * std::cos(phi), std::sin(t) * std::sin(phi),
                              std::cos(t));
    }
  }
  return directions;
}

double degreesBetween(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180 / std::numbers::pi;
}

std::shared_ptr<const FisheyeModel> lens(bool rich) {
  FisheyeParameters f;
  f.width = f.height = 1920;
  f.fx = 560;
  f.fy = 560.4;
  f.cx = 967.3;
  f.cy = 951.8;
  f.k = {0.042, -0.014, 0.0035, -0.0006, 0, 0};
  if (rich) {
    f.p = {0.0007, -0.0005};
    f.k[4] = 2e-5;
    f.s = {3e-4, 0, -2e-4, 0};
  }
  f.maxFieldAngle = Angle::degrees(95);
  LensUncertainty uncertainty;
  uncertainty.coveredField.assign(36, Angle::degrees(87));
  uncertainty.coveredField[5] = Angle::degrees(60);
  return *FisheyeModel::create(f, uncertainty);
}

// Largest angle between what two lenses make of the same pixel, where both see it.
double largestDegrees(const CameraModel& a, const CameraModel& b, double field) {
  double largest = 0;
  for (const Vector3d& v : directionsTo(field)) {
    const auto seen = b.unproject(*a.project(v));
    largest = std::max(largest, seen ? degreesBetween(*seen, v) : 180.0);
  }
  return largest;
}

TEST(CameraFormats, WhatAFormatHoldsComesBackAsItWas) {
  const TemporaryFolder folder;
  const auto model = lens(false);
  for (const char* name : {"lightsketch", "opencv", "kalibr"}) {
    const auto path = folder / (std::string("camera.") + name);
    const auto exported = exportCameraModel(*model, *cameraFormatFromName(name), path);
    ASSERT_TRUE(exported) << exported.error().message;
    EXPECT_FALSE(exported->refit) << name;
    const auto loaded = loadAnyCameraModel(path);
    ASSERT_TRUE(loaded) << loaded.error().message;
    EXPECT_FALSE(loaded->conversion.refit) << name;
    EXPECT_LT(largestDegrees(*model, *loaded->model, 94.9), 1e-6) << name;
    EXPECT_NEAR(loaded->model->maxFieldAngle().degrees(), 95, 1e-9) << name;
  }
}

TEST(CameraFormats, RefitsAreOffByWhatTheySayAndNoMore) {
  const TemporaryFolder folder;
  const auto model = lens(true);
  for (const char* name : {"opencv", "kalibr", "kalibr-ds", "mrcal"}) {
    const auto path = folder / (std::string("camera.") + name);
    const auto exported = exportCameraModel(*model, *cameraFormatFromName(name), path);
    ASSERT_TRUE(exported) << exported.error().message;
    EXPECT_TRUE(exported->refit);
    const auto loaded = loadAnyCameraModel(path);
    ASSERT_TRUE(loaded) << loaded.error().message;
    const double said =
        exported->largestError.degrees() + loaded->conversion.largestError.degrees();
    const double field = loaded->model->maxFieldAngle().degrees() - 0.2;
    const double actual = largestDegrees(*model, *loaded->model, field);
    // 2 percent: the report looks at other directions than this test.
    EXPECT_LE(actual, 1.02 * said) << name;
    // An empty bound would hold too; mrcal's spline is off at the very rim only.
    EXPECT_GE(actual, 0.3 * exported->largestError.degrees() - 1e-4) << name;
    EXPECT_NE(exported->text.find("off by at most"), std::string::npos);
  }
}

TEST(CameraFormats, FieldsThatAFormatCannotReachAreReportedLost) {
  const TemporaryFolder folder;
  const auto kalibr = exportCameraModel(*lens(true), CameraFormat::kKalibr, folder / "a.yaml");
  ASSERT_TRUE(kalibr);
  EXPECT_NEAR(kalibr->lostField.degrees(), 5, 1e-9);
  const auto sphere =
      exportCameraModel(*lens(true), CameraFormat::kKalibrDoubleSphere, folder / "b.yaml");
  ASSERT_TRUE(sphere);
  EXPECT_EQ(sphere->lostField.degrees(), 0);
}

TEST(CameraFormats, OpenCvProjectsWithOurFileToOurPixels) {
  const TemporaryFolder folder;
  const auto path = folder / "camera.yaml";
  const auto model = lens(false);
  ASSERT_TRUE(exportCameraModel(*model, CameraFormat::kOpenCv, path));
  cv::FileStorage file(path.string(), cv::FileStorage::READ);
  cv::Mat k;
  cv::Mat d;
  file["camera_matrix"] >> k;
  file["distortion_coefficients"] >> d;
  for (const Vector3d& v : directionsTo(85)) {
    const std::vector<cv::Point3d> point{{v.x(), v.y(), v.z()}};
    std::vector<cv::Point2d> pixel;
    cv::fisheye::projectPoints(point, pixel, cv::Vec3d(), cv::Vec3d(), k, d);
    const Vector2d ours = *model->project(v);
    EXPECT_NEAR(pixel[0].x + 0.5, ours.x(), 1e-8);  // rounding
    EXPECT_NEAR(pixel[0].y + 0.5, ours.y(), 1e-8);
  }
}

TEST(CameraFormats, MrcalProjectsWithOurFileToOurPixels) {
  const TemporaryFolder folder;
  const auto path = folder / "lens.cameramodel";
  const auto model = lens(true);
  const auto exported = exportCameraModel(*model, CameraFormat::kMrcal, path);
  ASSERT_TRUE(exported);
  mrcal_cameramodel_t* read = mrcal_read_cameramodel_file(path.c_str());
  ASSERT_NE(read, nullptr);
  EXPECT_EQ(read->imagersize[0], 1920u);
  for (const Vector3d& v : directionsTo(94.9)) {
    mrcal_point3_t p{};
    for (int i = 0; i < 3; ++i) p.xyz[i] = v[i];
    mrcal_point2_t q{};
    ASSERT_TRUE(mrcal_project(&q, nullptr, nullptr, &p, 1, &read->lensmodel, read->intrinsics));
    const auto seen = model->unproject({q.x + 0.5, q.y + 0.5});
    ASSERT_TRUE(seen);
    EXPECT_LE(degreesBetween(*seen, v), 1.02 * exported->largestError.degrees());
  }
  // Six decimals, as mrcal's own writer keeps them, would cost a thousandth of a pixel here.
  EXPECT_LT(exported->largestError.degrees(), 1e-3);
  mrcal_free_cameramodel(&read);
}

TEST(CameraFormats, MrcalsValidRegionIsTheCoveredField) {
  const TemporaryFolder folder;
  const auto path = folder / "lens.cameramodel";
  const auto model = lens(true);
  ASSERT_TRUE(exportCameraModel(*model, CameraFormat::kMrcal, path));
  const auto loaded = loadAnyCameraModel(path);
  ASSERT_TRUE(loaded);
  int differ = 0;
  for (const Vector3d& v : directionsTo(94)) {
    differ += model->covers(v) != loaded->model->covers(v);
  }
  // A polygon's straight sides cut the steps between sectors of 87 and 60 degrees: one azimuth of
  // the test, nine angles.
  EXPECT_LE(differ, 9);
  EXPECT_FALSE(loaded->model->covers(directionsTo(94).back()));
}

// A file's lens must project as its own equation does, written out here again.
void expectProjects(const TemporaryFolder& folder, const std::string& text,
                    const std::function<Vector2d(const Vector3d&)>& equation, double field,
                    double tolerance) {
  writeContent(folder / "camera.yaml", text);
  const auto loaded = loadAnyCameraModel(folder / "camera.yaml");
  ASSERT_TRUE(loaded) << loaded.error().message;
  ASSERT_GE(loaded->model->maxFieldAngle().degrees(), field) << loaded->conversion.text;
  EXPECT_LE(loaded->conversion.largestError.degrees(), tolerance) << loaded->conversion.text;
  for (const Vector3d& v : directionsTo(field)) {
    const auto seen = loaded->model->unproject(equation(v) + Vector2d(0.5, 0.5));
    ASSERT_TRUE(seen);
    EXPECT_LE(degreesBetween(*seen, v), 1.02 * loaded->conversion.largestError.degrees() + 1e-6)
        << loaded->conversion.text;
  }
}

std::string kalibr(const std::string& camera, const std::string& intrinsics,
                   const std::string& distortion, const std::string& coefficients) {
  return "cam0:\n  cam_overlaps: [1]\n  camera_model: " + camera +
         "\n  distortion_coeffs: " + coefficients + "\n  distortion_model: " + distortion +
         "\n  intrinsics: " + intrinsics +
         "\n  resolution: [800, 800]\n  rostopic: /cam0/image_raw\n  T_cam_imu:\n  - [1.0, 0.0, "
         "0.0, 0.1]\n  - [0.0, 1.0, 0.0, -2.0e-3]\n";
}

TEST(CameraFormats, KalibrFilesProjectByTheirOwnEquations) {
  const TemporaryFolder folder;
  expectProjects(
      folder,
      kalibr("pinhole", "[250.0, 251.0, 401.5, 398.0]", "equidistant", "[0.02, -0.01, 2e-3, 0.0]"),
      [](const Vector3d& v) {
        const double t = std::acos(v.z());
        const double d = t + 0.02 * std::pow(t, 3) - 0.01 * std::pow(t, 5) + 2e-3 * std::pow(t, 7);
        const double phi = std::atan2(v.y(), v.x());
        return Vector2d(250 * d * std::cos(phi) + 401.5, 251 * d * std::sin(phi) + 398);
      },
      85, 0);
  expectProjects(
      folder,
      kalibr("pinhole", "[420.0, 421.0, 401.5, 398.0]", "radtan", "[-0.1, 0.01, 0.001, -0.0005]"),
      [](const Vector3d& v) {
        const double x = v.x() / v.z();
        const double y = v.y() / v.z();
        const double r2 = x * x + y * y;
        const double c = 1 - 0.1 * r2 + 0.01 * r2 * r2;
        return Vector2d(420 * (c * x + 2 * 0.001 * x * y - 0.0005 * (r2 + 2 * x * x)) + 401.5,
                        421 * (c * y + 0.001 * (r2 + 2 * y * y) - 2 * 0.0005 * x * y) + 398);
      },
      40, 0.03);
  expectProjects(
      folder,
      kalibr("omni", "[1.2, 500.0, 501.0, 401.5, 398.0]", "radtan", "[0.01, 0.0, 0.0, 0.0]"),
      [](const Vector3d& v) {
        const double x = v.x() / (v.z() + 1.2);
        const double y = v.y() / (v.z() + 1.2);
        const double c = 1 + 0.01 * (x * x + y * y);
        return Vector2d(500 * c * x + 401.5, 501 * c * y + 398);
      },
      80, 0.01);
  expectProjects(
      folder, kalibr("ds", "[-0.2, 0.6, 230.0, 231.0, 401.5, 398.0]", "none", "[]"),
      [](const Vector3d& v) {
        const double z = v.z() - 0.2;
        const double d = std::sqrt(v.x() * v.x() + v.y() * v.y() + z * z);
        const double w = 0.6 * d + 0.4 * z;
        return Vector2d(230 * v.x() / w + 401.5, 231 * v.y() / w + 398);
      },
      95, 0.01);
  expectProjects(
      folder, kalibr("eucm", "[0.6, 1.1, 280.0, 281.0, 401.5, 398.0]", "none", "[]"),
      [](const Vector3d& v) {
        const double d = std::sqrt(1.1 * (v.x() * v.x() + v.y() * v.y()) + v.z() * v.z());
        const double w = 0.6 * d + 0.4 * v.z();
        return Vector2d(280 * v.x() / w + 401.5, 281 * v.y() / w + 398);
      },
      80, 0.01);
}

TEST(CameraFormats, OpenCvPinholesAndRosFilesAreRead) {
  const TemporaryFolder folder;
  const cv::Matx33d k(700, 0, 401.5, 0, 701, 298, 0, 0, 1);
  for (const std::vector<double>& d :
       {std::vector<double>{-0.2, 0.05, 0.001, -0.0005, 0.01},
        {0.1, 0.02, 0.001, -0.0005, 0.001, 0.3, 0.05, 0.002},
        {-0.2, 0.05, 0.001, -0.0005, 0.01, 0, 0, 0, 0.001, 0, 0.002, 0, 0.01, 0.02}}) {
    {
      cv::FileStorage file((folder / "out.yaml").string(), cv::FileStorage::WRITE);
      file << "image_width" << 800 << "image_height" << 600 << "camera_matrix" << cv::Mat(k)
           << "distortion_coefficients" << cv::Mat(d);
    }
    expectProjects(
        folder, contentOf(folder / "out.yaml"),
        [&](const Vector3d& v) {
          const std::vector<cv::Point3d> point{{v.x(), v.y(), v.z()}};
          std::vector<cv::Point2d> pixel;
          cv::projectPoints(point, cv::Vec3d(), cv::Vec3d(), k, d, pixel);
          return Vector2d(pixel[0].x, pixel[0].y);
        },
        30, 0.02);
  }
  expectProjects(
      folder,
      "image_width: 800\nimage_height: 600\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n"
      "  cols: 3\n  data: [700, 0, 401.5,\n         0, 701, 298, 0, 0, 1]\n"
      "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
      "  data: [0, 0, 0, 0, 0]\n",
      [](const Vector3d& v) {
        return Vector2d(700 * v.x() / v.z() + 401.5, 701 * v.y() / v.z() + 298);
      },
      30, 0.01);
}

TEST(CameraFormats, CvOmnidirFilesAreRead) {
  const TemporaryFolder folder;
  const char* const yaml =
      "%YAML:1.0\n---\nimage_size: [ 800, 800 ]\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
      "   dt: d\n   data: [ 500., 2., 401.5, 0., 501., 398., 0., 0., 1. ]\n"
      "D: !!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n   data: [ -0.05, 0.01, 0., 0. ]\n"
      "xi: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1.1 ]\n";
  const char* const xml =
      "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_size>\n  800 800</image_size>\n"
      "<K type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  <cols>3</cols>\n  <dt>d</dt>\n"
      "  <data>\n    500. 2. 401.5 0. 501. 398. 0. 0. 1.</data></K>\n"
      "<D type_id=\"opencv-matrix\"><rows>1</rows><cols>4</cols><dt>d</dt>\n"
      "  <data>-0.05 0.01 0. 0.</data></D>\n"
      "<xi type_id=\"opencv-matrix\"><rows>1</rows><cols>1</cols><dt>d</dt>\n"
      "  <data>1.1</data></xi>\n</opencv_storage>\n";
  for (const char* const text : {yaml, xml}) {
    SCOPED_TRACE(text);
    expectProjects(
        folder, text,
        [](const Vector3d& v) {
          const double x = v.x() / (v.z() + 1.1);
          const double y = v.y() / (v.z() + 1.1);
          const double r2 = x * x + y * y;
          const double c = 1 - 0.05 * r2 + 0.01 * r2 * r2;
          return Vector2d(500 * c * x + 2 * c * y + 401.5, 501 * c * y + 398);
        },
        75, 0.3);  // our lens has no skew
  }
}

TEST(CameraFormats, LensesOfMrcalAreRead) {
  const TemporaryFolder folder;
  for (const auto& [name, values] :
       {std::pair("LENSMODEL_PINHOLE", "700, 701, 401.5, 298"),
        {"LENSMODEL_STEREOGRAPHIC", "700, 701, 401.5, 298"},
        {"LENSMODEL_LONLAT", "700, 701, 401.5, 298"},
        {"LENSMODEL_OPENCV4", "700, 701, 401.5, 298, -0.2, 0.05, 0.001, -0.0005"},
        {"LENSMODEL_OPENCV5", "700, 701, 401.5, 298, -0.2, 0.05, 0.001, -0.0005, 0.01"},
        {"LENSMODEL_OPENCV8",
         "700, 701, 401.5, 298, 0.1, 0.02, 0.001, -5e-4, 0.001, 0.3, 0.05, 0.002"},
        {"LENSMODEL_CAHVOR", "700, 701, 401.5, 298, 0, 0, 0, 0.01, 0.001"}}) {
    SCOPED_TRACE(name);
    const std::string text = std::string("{ 'lensmodel': '") + name + "', 'intrinsics': [" +
                             values +
                             "], 'extrinsics': [0,0,0,0,0,0], 'imagersize': [800, 600] }\n";
    writeContent(folder / "in.cameramodel", text);
    mrcal_cameramodel_t* read = mrcal_read_cameramodel_string(text.c_str(), 0);
    ASSERT_NE(read, nullptr);
    // Our lens is a fisheye: tangents and longitudes are only near it.
    expectProjects(
        folder, text,
        [&](const Vector3d& v) {
          mrcal_point3_t p{};
          for (int i = 0; i < 3; ++i) p.xyz[i] = v[i];
          mrcal_point2_t q{};
          mrcal_project(&q, nullptr, nullptr, &p, 1, &read->lensmodel, read->intrinsics);
          return Vector2d(q.x, q.y);
        },
        25, std::string(name) == "LENSMODEL_LONLAT" ? 3 : 0.05);
    mrcal_free_cameramodel(&read);
  }
}

TEST(CameraFormats, DamagedAndForeignFilesAreRefusedInWords) {
  const TemporaryFolder folder;
  const auto message = [&](const std::string& text) {
    writeContent(folder / "camera.yaml", text);
    const auto loaded = loadAnyCameraModel(folder / "camera.yaml");
    EXPECT_FALSE(loaded) << text;
    return loaded ? std::string() : loaded.error().message;
  };
  EXPECT_NE(message("nothing of the kind").find("no camera file"), std::string::npos);
  EXPECT_NE(message("").find("no camera file"), std::string::npos);
  EXPECT_NE(message("%YAML:1.0\n---\nK: [1, 2\n").find("camera.yaml"), std::string::npos);
  EXPECT_NE(message("<?xml version=\"1.0\"?>\n<a>\n<b></a>").find("line 3: mismatched tag"),
            std::string::npos);
  EXPECT_NE(message("%YAML:1.0\n---\nimage_width: 10\nimage_height: 10\n").find("camera_matrix"),
            std::string::npos);
  EXPECT_NE(message(kalibr("pinhole", "[250, 251, 401.5]", "equidistant", "[0, 0, 0, 0]"))
                .find("3 intrinsics"),
            std::string::npos);
  EXPECT_NE(message(kalibr("pinhole", "[250, 251, 401.5, 398]", "fov", "[0.9, 0, 0, 0]"))
                .find("known: pinhole-equidistant"),
            std::string::npos);
  EXPECT_NE(message(kalibr("pinhole", "[250, x, 401.5, 398]", "radtan", "[0, 0, 0, 0]"))
                .find("not a list of numbers"),
            std::string::npos);
  EXPECT_NE(message("{ 'lensmodel': 'LENSMODEL_NONE' }").find("mrcal"), std::string::npos);
  EXPECT_EQ(loadAnyCameraModel(folder / "absent.yaml").error().code, ErrorCode::kNotFound);
  EXPECT_NE(cameraFormatFromName("matlab").error().message.find("kalibr-ds"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
